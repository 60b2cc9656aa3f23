"""A CAN frame as a value, and how much of a bus it takes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

_FIXED_BITS = 47  # ISO 11898-1, base format: SOF, id, RTR, IDE, r0, DLC, CRC, ACK, EOF and interframe space.
_STUFFED_BITS = 34  # Those of them that are subject to bit stuffing.


class Frame(NamedTuple):
    """A frame with an 11-bit identifier."""

    id: int
    data: bytes = b""
    remote: bool = False

    def __str__(self) -> str:
        return f"{self.id:03X}#{'R' if self.remote else self.data.hex().upper()}"


class JointFrames(NamedTuple):
    """The frames of all joints, a finger's each, index to thumb, that stand on the bus one after the other."""

    id: tuple[int, ...]
    """Identifiers of the frames, one a finger."""
    data: bytes
    """Data of all four frames, 32 bytes."""
    remote: bool = False

    @property
    def frames(self) -> tuple[Frame, ...]:
        """Each by itself."""
        return tuple(Frame(k, self.data[8 * n : 8 * n + 8]) for n, k in enumerate(self.id))


LOST = Frame(-1)
"""Stands among received frames where some were lost."""


def single(frames: Iterable[Frame | JointFrames]) -> list[Frame]:
    """Each frame by itself."""
    return [frame for some in frames for frame in (some.frames if isinstance(some, JointFrames) else (some,))]


def bits(length: int) -> int:
    """The most bits that a frame with `length` data bytes takes on the bus, worst-case stuffing included."""
    return _FIXED_BITS + 8 * length + (_STUFFED_BITS + 8 * length - 1) // 4
