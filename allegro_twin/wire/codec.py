"""The contract of a codec, and what one hand's codec has to know about that very hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeAlias

from allegro_twin.errors import ConfigError, ProtocolError
from allegro_twin.wire.frames import Frame
from allegro_twin.wire.messages import Message, Request, Topic

Decoder: TypeAlias = Callable[[Frame], Message]
Encoder: TypeAlias = Callable[[Any], Frame]
Version: TypeAlias = Literal["v1", "v2", "v3", "v4", "v5", "v5plus"]
FINGERS = ("index", "middle", "ring", "thumb")
"""In the order of the wire. Source: R4 AllegroHandDef.h; R2 v4_spec.hpp:89-94."""
_ONES = (1,) * 16


@dataclass(frozen=True, slots=True)
class Calibration:
    """What turns counts into joint positions and torques on one hand: 16 values, index to thumb, palm outward.

    Raises ConfigError for a wrong number of values, a direction that is not ±1, a torque constant that is not positive.
    """

    encoder_offset: tuple[int, ...] = (0,) * 16
    """Counts; v1–v3 only."""
    encoder_direction: tuple[int, ...] = _ONES
    """±1; v1–v3 only."""
    motor_direction: tuple[int, ...] = _ONES
    """±1; v1–v3 only."""
    torque_constant: tuple[float, ...] = (1.0,) * 16
    """N·m at full PWM (v5: at 1430 mA). Nominal: nobody has published it for v1–v4."""
    torque_order: Literal["reversed", "straight"] = "straight"
    """v1 only: whether a finger's four torques go from tip to palm, as on v2 and v3. Sources disagree; the default is
    that of the manufacturer's ROS drivers, which alone ship calibrations of v1 hands."""

    def __post_init__(self) -> None:
        for name in ("encoder_offset", "encoder_direction", "motor_direction", "torque_constant"):
            values = getattr(self, name)
            if len(values) != 16:
                raise ConfigError(f"{name} needs 16 values, one a joint; it has {len(values)}")
            if name.endswith("direction") and any(value not in (1, -1) for value in values):
                raise ConfigError(f"{name} must be 1 or -1 for every joint: {list(values)}")
        if not all(0.0 < value < math.inf for value in self.torque_constant):
            raise ConfigError(f"torque_constant must be positive: {list(self.torque_constant)}")


class Codec(Protocol):
    """Between messages and frames, for one hand on the bus. Pure: no state, no clock, no bus."""

    @property
    def version(self) -> Version:
        """Which generation of the hand."""
        ...

    def encode(self, message: Message) -> Frame:
        """Values beyond what the wire can say are saturated. Raises ProtocolError where this version has no such
        message."""
        ...

    def decode(self, frame: Frame) -> Message | None:
        """None for a frame that is not this hand's. Raises ProtocolError for a malformed one, and nothing else."""
        ...

    def opening(self, position: float, imu: float, temperature: float) -> tuple[Message, ...]:
        """What to say before servo on, so that the hand takes torques, and reports with these periods what its version
        can report by itself, s; 0: never."""
        ...

    def closing(self) -> tuple[Message, ...]:
        """What to say after zero torque, so that the hand is limp and silent."""
        ...

    @property
    def identifies(self) -> bool:
        """Whether this version says who it is when asked."""
        ...


def no_such(message: Message, version: str) -> ProtocolError:
    return ProtocolError(f"a {version} hand has no message {type(message).__name__}")


def malformed(frame: Frame, why: str) -> ProtocolError:
    return ProtocolError(f"frame {frame} is malformed: {why}")


def exactly(frame: Frame, *lengths: int) -> bytes:
    """The data of a frame that must not be remote. Raises ProtocolError when it has none of the lengths."""
    if len(frame.data) in lengths and not frame.remote:
        return frame.data
    raise malformed(frame, f"{len(frame.data)} data bytes instead of {' or '.join(map(str, lengths))}")


def asked(frame: Frame, request: Request, length: int) -> Request:
    """The request that a frame is when it comes remote, or without data as from links that cannot say remote."""
    if frame.remote or not frame.data:
        return request
    raise malformed(frame, f"{len(frame.data)} data bytes instead of {length}")


def answer(topic: Topic, finger: int | None, length: int, read: Callable[[bytes], Message]) -> Decoder:
    """Of an identifier that the host asks with and the hand answers with."""
    request = Request(topic, finger)

    def decode(frame: Frame) -> Message:
        if len(frame.data) == length and not frame.remote:
            return read(frame.data)
        return asked(frame, request, length)

    return decode
