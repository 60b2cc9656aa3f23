"""The contract of a codec: between messages and frames, for one hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Any, NamedTuple, Protocol, TypeAlias

from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.lanes import Limits, Positions, Torques
from allegro_twin.drivers.can.codec.messages import Message, Request, Topic
from allegro_twin.errors import ProtocolError
from allegro_twin.hands.description.calibration import HandCalibration, Version

Decoder: TypeAlias = Callable[[Frame], Message]
Encoder: TypeAlias = Callable[[Any], Frame]
FINGERS = ("index", "middle", "ring", "thumb")
"""In the order of the wire. Source: R4 AllegroHandDef.h; R2 v4_spec.hpp:89-94."""


class ServoAnswer(NamedTuple):
    """Request and answer that tell whether a hand's motors are on."""

    ask: Frame
    byte: int
    """Index of the byte in the answer, which has the same identifier."""
    mask: int
    """The bit that says that they are on."""


class Codec(Protocol):
    """Conversion between messages and frames, for one hand on the bus. Pure: no state, no clock, no bus."""

    @property
    def version(self) -> Version:
        """Which generation of the hand."""
        ...

    @property
    def calibration(self) -> HandCalibration:
        """What is particular of this very hand."""
        ...

    @property
    def rad_per_count(self) -> float:
        """Resolution of a joint's report, rad a count."""
        ...

    @property
    def positions(self) -> Positions:
        """The reports of the joints, for all fingers at once."""
        ...

    @property
    def torques(self) -> Torques:
        """The commands to the motors, for all fingers at once."""
        ...

    @property
    def servo_answer(self) -> ServoAnswer | None:
        """How this version is asked whether its motors are on; None: it cannot be."""
        ...

    @property
    def pwm_limits(self) -> Limits:
        """The most counts that this hand's driver sends to each motor, (16,)."""
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


def described(codec: Codec) -> dict[str, Any]:
    """What a recording should say of how counts became rad and N·m."""
    limits = [int(limit) for limit in codec.pwm_limits]
    return {"version": codec.version, **asdict(codec.calibration), "pwm_limit": limits}


def no_such(message: Message, version: str) -> ProtocolError:
    return ProtocolError(f"a {version} hand has no message {type(message).__name__}")


def malformed(frame: Frame, why: str) -> ProtocolError:
    return ProtocolError(f"frame {frame} is malformed: {why}")


def exactly(frame: Frame, *lengths: int) -> bytes:
    """The data of a frame that must not be remote. Raises ProtocolError when it has none of the lengths."""
    if len(frame.data) in lengths and not frame.remote:
        return frame.data
    raise malformed(frame, f"{len(frame.data)} data bytes instead of {' or '.join(map(str, lengths))}")


def parse_request(frame: Frame, request: Request, length: int) -> Request:
    """The request that a frame is when it comes remote, or without data as from links that cannot say remote."""
    if frame.remote or not frame.data:
        return request
    raise malformed(frame, f"{len(frame.data)} data bytes instead of {length}")


def answer(topic: Topic, finger: int | None, length: int, read: Callable[[bytes], Message]) -> Decoder:
    """Decoder of an identifier that the host asks with and the hand answers with."""
    request = Request(topic, finger)

    def decode(frame: Frame) -> Message:
        if len(frame.data) == length and not frame.remote:
            return read(frame.data)
        return parse_request(frame, request, length)

    return decode
