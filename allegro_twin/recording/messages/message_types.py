"""Message types of a ROS 2 distribution: makes, encodes and decodes messages."""

from __future__ import annotations

from functools import cache
from typing import Any, Literal, TypeAlias, get_args

from allegro_twin.errors import ConfigError, unknown

Distro: TypeAlias = Literal["humble", "iron", "jazzy", "kilted", "lyrical"]
DISTROS: tuple[Distro, ...] = get_args(Distro)
Message: TypeAlias = Any
"""A message of rosbags: a dataclass made from its definition, with arrays for numbers."""

JOINT_STATE = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
TF = "tf2_msgs/msg/TFMessage"
WRENCH = "geometry_msgs/msg/WrenchStamped"
POSE = "geometry_msgs/msg/PoseStamped"
CLOUD = "sensor_msgs/msg/PointCloud2"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
STRING = "std_msgs/msg/String"
FLOAT = "std_msgs/msg/Float32"
VECTOR = "geometry_msgs/msg/Vector3"
LOG = "rcl_interfaces/msg/Log"
NODES = "rmw_dds_common/msg/ParticipantEntitiesInfo"


class RosTypes:
    """The message types of one distribution."""

    def __init__(self, distro: Distro) -> None:
        self.distro, self.store = distro, _typestore(distro)

    def make(self, kind: str, **fields: Any) -> Message:
        """Make a message of a type such as `std_msgs/msg/String`."""
        return self.store.types[kind](**fields)

    def encode(self, message: Message) -> bytes:
        """Encode a message as CDR, little-endian, with its header of four bytes, as on the wire and in a bag."""
        return bytes(self.store.serialize_cdr(message, message.__msgtype__))

    def decode(self, data: bytes, kind: str) -> Message:
        """Decode CDR bytes. Raises ConfigError for bytes that are not of that type."""
        from rosbags.serde import SerdeError

        try:
            return self.store.deserialize_cdr(data, kind)
        except SerdeError as error:
            raise ConfigError(f"{len(data)} bytes are no {kind}: {error}") from error

    def definition(self, kind: str) -> str:
        """The .msg text with those of all types inside it, as bags carry it."""
        return str(self.store.generate_msgdef(kind, ros_version=2)[0])

    def hash(self, kind: str) -> str:
        """`RIHS01_…`, the hash by which ROS 2 since Iron compares types."""
        return str(self.store.hash_rihs01(kind))

    def fields(self, kind: str) -> list[tuple[str, tuple[Any, Any]]]:
        """Names of a type's fields, with their types as rosbags writes them: a node type and its arguments."""
        return list(self.store.fielddefs[kind][1])

    def time(self, nanoseconds: int) -> Message:
        """A time since 1970, ns."""
        return self.make("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)

    def header(self, nanoseconds: int, frame: str = "") -> Message:
        return self.make("std_msgs/msg/Header", stamp=self.time(nanoseconds), frame_id=frame)


@cache
def ros_types(distro: Distro = "jazzy") -> RosTypes:
    """The types of a distribution, loaded once. Raises ConfigError without the extra."""
    return RosTypes(distro)


def ros_types_by_name(distro: str) -> RosTypes:
    """The types of a distribution by name. Raises ConfigError with the known names."""
    for known in DISTROS:
        if distro == known:
            return ros_types(known)
    raise ConfigError(unknown("ROS 2 distribution", distro, DISTROS))


def nanoseconds(time: Message) -> int:
    """Convert a Time or a Duration."""
    return int(time.sec) * 10**9 + int(time.nanosec)


def _typestore(distro: Distro) -> Any:
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise ConfigError(f"ROS messages need rosbags: pip install 'allegro-twin[ros2]' ({error})") from error
    return get_typestore(Stores(f"ros2_{distro}"))
