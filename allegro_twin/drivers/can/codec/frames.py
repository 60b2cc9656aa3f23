"""A CAN frame as a value, and how much of a bus it takes."""

from __future__ import annotations

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


LOST = Frame(-1)
"""Stands among received frames where some were lost."""


def bits(length: int) -> int:
    """The most bits that a frame with `length` data bytes takes on the bus, worst-case stuffing included."""
    return _FIXED_BITS + 8 * length + (_STUFFED_BITS + 8 * length - 1) // 4
