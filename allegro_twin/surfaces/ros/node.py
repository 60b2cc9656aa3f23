"""A ROS 2 node as other nodes see it on the wire: topics, their types, qualities of service, and discovery."""

from __future__ import annotations

import os
from functools import cache
from typing import Any
from uuid import UUID

import numpy as np
from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl.types import array, float32, float64, int8, int16, int32, int64, sequence, uint8, uint16, uint32
from cyclonedds.idl.types import uint64 as uint64
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.interfaces import Nodetype

from allegro_twin.errors import ConfigError, LinkError
from allegro_twin.recording.messages.message_types import NODES, Message, RosTypes
from allegro_twin.surfaces.ros.node_api import NAME, PLAIN, QosProfile, Received, checked, full

_BASE = {
    "bool": bool, "byte": uint8, "char": uint8, "octet": uint8, "string": str, "float32": float32, "float64": float64,
    "int8": int8, "int16": int16, "int32": int32, "int64": int64,
    "uint8": uint8, "uint16": uint16, "uint32": uint32, "uint64": uint64,
}  # fmt: skip


def dds_name(kind: str) -> str:
    """`std_msgs/msg/String` as DDS has it: `std_msgs::msg::dds_::String_`."""
    package, folder, name = kind.split("/")
    return f"{package}::{folder}::dds_::{name}_"


@cache
def struct(types: RosTypes, kind: str) -> type[IdlStruct]:
    """The type with its fields, which Cyclone DDS can read and write by itself."""
    fields = {name: _field(types, shape) for name, shape in types.fields(kind)}
    made: type[IdlStruct] = make_idl_struct(kind.split("/")[-1], dds_name(kind).replace("::", "."), fields)
    return made


@cache
def wire(types: RosTypes, kind: str) -> type[Any]:
    """Message type with the same name, whose samples are CDR bytes that stay undecoded."""
    inner = struct(types, kind)

    class Wire(inner):  # type: ignore[misc, valid-type]  # The base is made at run time.
        def __init__(self, data: bytes) -> None:
            self.data = data

        def serialize(self, *_: Any, **__: Any) -> bytes:
            return self.data

        @classmethod
        def deserialize(cls, data: bytes, *_: Any, **__: Any) -> Any:
            return cls(bytes(data))

    Wire.__idl__ = inner.__idl__
    return Wire


def _field(types: RosTypes, shape: tuple[Any, Any]) -> Any:
    node, args = shape
    if node == Nodetype.BASE:
        return _BASE[args[0]]
    if node == Nodetype.NAME:
        return struct(types, args)
    inner, length = _field(types, args[0]), args[1]
    return array[inner, length] if node == Nodetype.ARRAY else sequence[inner]


HIGHEST = 232
"""Highest domain id: the ports of a higher one do not exist, DDSI-RTPS 9.6.1."""
LOOPBACK = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo"/></Interfaces>
</General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>99</MaxAutoParticipantIndex><Peers><Peer address="localhost"/></Peers></Discovery>
</Domain></CycloneDDS>"""
"""Only this machine, as ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST has it."""
_domains: dict[int, Domain] = {}
"""A process configures a domain once."""


def qos_of(quality: QosProfile, *more: Any) -> Qos:
    """A quality of service as Cyclone DDS has it; everything is reliable."""
    durability = Policy.Durability.TransientLocal if quality.latched else Policy.Durability.Volatile
    return Qos(
        Policy.Reliability.Reliable(duration(milliseconds=100)),
        durability,
        Policy.History.KeepLast(quality.depth),
        Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
        *more,
    )


class Node:
    """One participant with one node. Nothing waits here but `wait`. Raises ConfigError for a name or a domain that ROS
    does not allow, LinkError where the network does not let it."""

    def __init__(self, types: RosTypes, name: str, namespace: str, domain: int, *, network: bool = False) -> None:
        self.types, self.name, self.namespace = types, name, checked(namespace)
        if not 0 <= domain <= HIGHEST:
            raise ConfigError(f"ROS_DOMAIN_ID must be 0 to {HIGHEST}, not {domain}")
        if not NAME.fullmatch(name):
            raise ConfigError(f"a node is named with letters, digits and _, not {name!r}")
        try:
            if not network and "CYCLONEDDS_URI" not in os.environ and domain not in _domains:
                _domains[domain] = Domain(domain, LOOPBACK)
            self._participant = DomainParticipant(domain, Qos(Policy.Userdata(b"enclave=/;")))
        except DDSException as error:
            raise LinkError(f"cannot join ROS domain {domain}: {error.msg}; try another --domain") from error
        self._writers: dict[str, Any] = {}
        self._readers: dict[str, Any] = {}
        self._waiting = WaitSet(self._participant)
        self._nodes = self._writer("ros_discovery_info", NODES, QosProfile(1, latched=True), hashed=False)

    def advertise(self, topic: str, kind: str, quality: QosProfile = PLAIN) -> None:
        """Begin to publish a topic."""
        self._writers[topic] = self._writer(self._dds(topic), kind, quality)

    def subscribe(self, topic: str, kind: str, quality: QosProfile = PLAIN) -> None:
        """Begin to hear a topic."""
        place = Topic(self._participant, self._dds(topic), wire(self.types, kind))
        reader = DataReader(self._participant, place, qos_of(quality, self._hash(kind)))
        self._readers[topic] = reader
        self._waiting.attach(ReadCondition(reader, SampleState.NotRead | ViewState.Any | InstanceState.Any))

    def announce(self) -> None:
        """Tell the world of this node and its topics; after the last `advertise` and `subscribe`."""
        make, gid = self.types.make, self._gid
        entities = make(
            "rmw_dds_common/msg/NodeEntitiesInfo",
            node_namespace=self.namespace,
            node_name=self.name,
            reader_gid_seq=[gid(reader.guid) for reader in self._readers.values()],
            writer_gid_seq=[gid(writer.guid) for writer in self._writers.values()],
        )
        info = make(NODES, gid=gid(self._participant.guid), node_entities_info_seq=[entities])
        self._send(self._nodes, info)

    def publish(self, topic: str, message: Message) -> None:
        """Raises LinkError when the network does not take it."""
        self._send(self._writers[topic], message)

    def wait(self, seconds: float) -> list[Received]:
        """What came on all topics, oldest first on each; after so long at most, s."""
        self._waiting.wait(duration(milliseconds=round(seconds * 1000)))
        found = []
        for topic, reader in self._readers.items():
            for sample in reader.take(N=20):
                if sample.sample_info.valid_data:
                    found.append(Received(topic, sample.data, self._sender(reader, sample)))
        return found

    def senders(self, topic: str) -> int:
        """How many publishers a topic has that is subscribed here."""
        return len(self._readers[topic].get_matched_publications())

    def close(self) -> None:
        """Leave the domain, when the last words were heard or 0.2 s have passed. Idempotent."""
        for writer in self._writers.values():
            try:
                writer.wait_for_acks(duration(milliseconds=200))
            except (DDSException, AttributeError):
                break  # Somebody does not listen any more; cyclonedds 11.0.1 misnames its own time-out.
        self._readers.clear()
        self._writers.clear()
        self.__dict__.pop("_waiting", None)
        self.__dict__.pop("_nodes", None)
        self.__dict__.pop("_participant", None)

    def _writer(self, name: str, kind: str, quality: QosProfile, *, hashed: bool = True) -> Any:
        place = Topic(self._participant, name, wire(self.types, kind))
        return DataWriter(self._participant, place, qos_of(quality, *([self._hash(kind)] if hashed else [])))

    def _send(self, writer: Any, message: Message) -> None:
        try:
            writer.write(wire(self.types, message.__msgtype__)(self.types.encode(message)))
        except DDSException as error:
            raise LinkError(f"{self.name}: cannot publish: {error.msg}") from error

    def _hash(self, kind: str) -> Any:
        """Where ROS 2 since Iron looks for it."""
        return Policy.Userdata(f"typehash={self.types.hash(kind)};".encode())

    def _gid(self, guid: UUID) -> Message:
        length = dict(self.types.fields("rmw_dds_common/msg/Gid"))["data"][1][1]
        return self.types.make("rmw_dds_common/msg/Gid", data=np.frombuffer(guid.bytes.ljust(length, b"\0"), np.uint8))

    def _sender(self, reader: Any, sample: Any) -> UUID:
        known = reader.get_matched_publication_data(sample.sample_info.publication_handle)
        return UUID(int=0) if known is None else UUID(bytes=known.participant_key.bytes)

    def _dds(self, topic: str) -> str:
        return f"rt{full(topic, self.namespace)}"
