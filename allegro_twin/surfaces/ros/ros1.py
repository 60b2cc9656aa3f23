"""A ROS 1 node with the same topics, by rospy. Messages are converted byte by byte: no message package is needed."""

from __future__ import annotations

import queue
import uuid
from functools import cache
from typing import Any

from allegro_twin.errors import ConfigError, LinkError
from allegro_twin.recording.messages import message_types as v
from allegro_twin.surfaces.ros.node_api import PLAIN, QosProfile, Received, checked, full

HINT = "apt-get install python3-rospy, in an environment made with --system-site-packages; docs/how-to/use_ros.md"
TF = "tf2_msgs/msg/TFMessage"


class Ros1Node:
    """One node at a master. Raises ConfigError without rospy, LinkError without a master."""

    def __init__(self, types: v.RosTypes, name: str, namespace: str) -> None:
        self.types, self.name, self.namespace = types, name, checked(namespace)
        self._ros, graph = _rospy()
        if not graph.is_master_online():
            raise LinkError(f"no ROS 1 master at {graph.get_master_uri()}: start roscore, or set ROS_MASTER_URI")
        self._store = _store()
        self._ros.init_node(name, disable_signals=True)
        self._publishers: dict[str, Any] = {}
        self._subscribers: list[Any] = []
        self._heard: queue.Queue[Received] = queue.Queue(maxsize=1000)

    def advertise(self, topic: str, kind: str, quality: QosProfile = PLAIN) -> None:
        """Begin to publish a topic."""
        if kind == v.LOG:
            return  # ROS 1 has another type for it, and rospy says what is logged.
        self._publishers[topic] = self._ros.Publisher(
            full(topic, self.namespace), self._raw(kind), latch=quality.latched, queue_size=quality.depth
        )

    def subscribe(self, topic: str, kind: str, quality: QosProfile = PLAIN) -> None:
        """Begin to hear a topic."""

        def hear(message: Any) -> None:
            sender = uuid.uuid5(uuid.NAMESPACE_URL, message._connection_header["callerid"])
            data = bytes(self.types.store.ros1_to_cdr(message.data, kind))
            self._heard.put(Received(topic, data, sender))

        self._subscribers.append(
            self._ros.Subscriber(full(topic, self.namespace), self._raw(kind), hear, queue_size=quality.depth)
        )

    def publish(self, topic: str, message: v.Message) -> None:
        """Pass a message on; a refusal of a wish goes to rospy's own log."""
        if message.__msgtype__ == v.LOG:
            self._ros.logwarn(message.msg)
            return
        kind = message.__msgtype__
        self._publishers[topic].publish(
            self._raw(kind)(bytes(self.types.store.cdr_to_ros1(self.types.encode(message), kind)))
        )

    def wait(self, seconds: float) -> list[Received]:
        """What came on all topics; after so long at most, s."""
        found = []
        try:
            found.append(self._heard.get(timeout=seconds))
            while True:
                found.append(self._heard.get_nowait())
        except queue.Empty:
            return found

    def close(self) -> None:
        """Leave the master."""
        self._ros.signal_shutdown("the bridge has ended")

    def _raw(self, kind: str) -> type[Any]:
        return _raw(self._store, kind)


@cache
def _raw(store: Any, kind: str) -> type[Any]:
    """A message class of rospy whose samples are bytes."""
    import genpy

    text, md5 = store.generate_msgdef(kind, ros_version=1)

    class Raw(genpy.Message):  # type: ignore[misc]  # genpy is not typed.
        _type, _md5sum, _full_text, _has_header = kind.replace("/msg/", "/"), md5, text, False
        __slots__ = ("data",)
        _slot_types = ("uint8[]",)

        def __init__(self, data: bytes = b"") -> None:
            self.data = data

        def serialize(self, buff: Any) -> None:
            buff.write(self.data)

        def deserialize(self, data: bytes) -> Any:
            self.data = bytes(data)
            return self

    return Raw


@cache
def _store() -> Any:
    """Noetic's types, and the one of tf2 that rosbags leaves out there."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    if TF not in store.fielddefs:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    return store


def _rospy() -> tuple[Any, Any]:
    try:
        import rosgraph
        import rospy
    except ImportError as error:
        raise ConfigError(f"ros1 needs rospy: {HINT} ({error})") from error
    return rospy, rosgraph
