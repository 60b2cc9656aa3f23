"""Integers on the wire: they saturate and never wrap."""

from __future__ import annotations

import math
from struct import Struct

from allegro_twin.errors import ProtocolError

LITTLE = Struct("<4h")
"""Four signed words of a finger, little-endian: v4 and v5, both ways."""
_EPSILON = 1e-9  # A decoded count must encode to itself: c / 1200 · 1200 may fall short of c by a rounding.


def truncated(value: float, limit: int) -> int:
    """Toward zero, as the manufacturer's drivers cast, and inside ±limit. Raises ProtocolError for NaN."""
    if value >= 0.0:
        return limit if value >= limit else int(value + _EPSILON)
    if value < 0.0:
        return -limit if value <= -limit else int(value - _EPSILON)
    raise ProtocolError("NaN cannot be put on the wire")


def nearest(value: float, low: int, high: int) -> int:
    """The nearest count, inside [low, high]. Raises ProtocolError for NaN."""
    if low <= value <= high:
        return math.floor(value + 0.5)
    if value < low:
        return low
    if value > high:
        return high
    raise ProtocolError("NaN cannot be put on the wire")


def int16(value: float) -> int:
    """The nearest signed 16-bit count."""
    return math.floor(value + 0.5) if -32768.0 <= value <= 32767.0 else nearest(value, -32768, 32767)
