"""Types of ROS 2 as Cyclone DDS wants them for a topic. Samples are bytes that `messages` has made and will read."""

from __future__ import annotations

from functools import cache
from typing import Any

from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl.types import array, float32, float64, int8, int16, int32, int64, sequence, uint8, uint16, uint32
from cyclonedds.idl.types import uint64 as uint64
from rosbags.interfaces import Nodetype

from allegro_twin.recording.messages.message_types import RosTypes

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
def struct(words: RosTypes, kind: str) -> type[IdlStruct]:
    """The type with its fields, which Cyclone DDS can read and write by itself."""
    fields = {name: _field(words, shape) for name, shape in words.fields(kind)}
    made: type[IdlStruct] = make_idl_struct(kind.split("/")[-1], dds_name(kind).replace("::", "."), fields)
    return made


@cache
def wire(words: RosTypes, kind: str) -> type[Any]:
    """The same type, whose samples are CDR bytes that nobody takes apart."""
    inner = struct(words, kind)

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


def _field(words: RosTypes, shape: tuple[Any, Any]) -> Any:
    node, args = shape
    if node == Nodetype.BASE:
        return _BASE[args[0]]
    if node == Nodetype.NAME:
        return struct(words, args)
    inner, length = _field(words, args[0]), args[1]
    return array[inner, length] if node == Nodetype.ARRAY else sequence[inner]
