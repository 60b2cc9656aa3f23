"""Sixteen values in four frames, a finger each: joint positions that come, and torques that go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isnan
from struct import Struct
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from allegro_twin.drivers.can.codec.counts import nearest, truncated
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.messages import Four
from allegro_twin.errors import ProtocolError
from allegro_twin.types import Vector

Limits: TypeAlias = NDArray[np.int_]
_EPSILON = 1e-9  # As in counts.truncated.
_TURNED = np.arange(16).reshape(4, 4)[:, ::-1].ravel()
"""Each finger's four the other way round."""


class Positions:
    """value = count · scale + at, in rad; counts are the nearest, inside what the wire can say."""

    def __init__(
        self,
        identifiers: Sequence[int],
        kind: str,
        scale: Sequence[float],
        at: Sequence[float],
        also: Mapping[int, int] = MappingProxyType({}),
    ) -> None:
        """`kind`: of a word, as in `struct`, `h` or `H`; `scale`, `at`: rad a count and rad at count 0, 16 each;
        `also`: fingers by further identifiers that are read."""
        self.identifiers = tuple(identifiers)
        self.fingers = {identifier: finger for finger, identifier in enumerate(identifiers)} | dict(also)
        """Whose report an identifier is."""
        self._one = Struct(f"<4{kind}")
        self._scale, self._at = tuple(scale), tuple(at)
        self._range = (0, 0xFFFF) if kind == "H" else (-0x8000, 0x7FFF)
        self._word, self._scales, self._ats = np.dtype(f"<{kind}"), np.array(scale), np.array(at)

    def values(self, data: bytes) -> Vector:
        """What the data of all four frames say, 32 bytes; read-only, (16,), rad."""
        found: Vector = np.frombuffer(data, self._word) * self._scales
        found += self._ats
        found.setflags(write=False)
        return found

    def four(self, finger: int, data: bytes) -> Four:
        """What the data of a finger's frame say, 8 bytes."""
        first, (a, b, c, d) = 4 * finger, self._one.unpack(data)
        (p, q, r, s), (t, u, v, w) = self._scale[first : first + 4], self._at[first : first + 4]
        return (a * p + t, b * q + u, c * r + v, d * s + w)

    def frames(self, values: Vector) -> tuple[Frame, ...]:
        """All four frames of (16,), rad. Raises ProtocolError for NaN."""
        low, high = self._range
        counts = (values - self._ats) / self._scales
        counts += 0.5
        counts = _within(np.floor(counts, out=counts), low, high)
        return _cut(self.identifiers, counts.astype(self._word).tobytes())

    def frame(self, finger: int, four: Four) -> Frame:
        """A finger's frame. Raises ProtocolError for NaN."""
        first, (low, high) = 4 * finger, self._range
        counts = [nearest((four[k] - self._at[first + k]) / self._scale[first + k], low, high) for k in range(4)]
        return Frame(self.identifiers[finger], self._one.pack(*counts))


class Torques:
    """count = torque · scale, N·m, cut toward zero as the manufacturer's casts do."""

    def __init__(
        self, identifiers: Sequence[int], order: str, scale: Sequence[float], limit: int, *, backwards: bool = False
    ) -> None:
        """`order`: of the bytes, `<` or `>`; `scale`: counts for 1 N·m, 16; `limit`: full scale, counts; `backwards`:
        a finger's joints go from the tip to the palm."""
        self.identifiers = tuple(identifiers)
        self.fingers = {identifier: finger for finger, identifier in enumerate(identifiers)}
        """Whose torques an identifier carries."""
        self._one, self._word = Struct(f"{order}4h"), np.dtype(f"{order}i2")
        self._scale, self._worth = tuple(scale), tuple(1.0 / value for value in scale)
        self._scales, self._worths = np.array(self._scale), np.array(self._worth)
        self._limit, self._backwards = limit, backwards
        self.zero = _cut(self.identifiers, bytes(32))
        """The frames that ask every motor for nothing."""

    def values(self, data: bytes | bytearray) -> Vector:
        """What the data of all four frames mean, 32 bytes; (16,), N·m."""
        counts = np.frombuffer(data, self._word)
        if self._backwards:
            counts = counts[_TURNED]
        found: Vector = counts * self._worths
        return found

    def four(self, finger: int, data: bytes) -> Four:
        """What the data of a finger's frame mean, 8 bytes; N·m."""
        first, counts = 4 * finger, self._one.unpack(data)
        a, b, c, d = reversed(counts) if self._backwards else counts
        p, q, r, s = self._worth[first : first + 4]
        return (a * p, b * q, c * r, d * s)

    def frames(self, torque: Vector, limits: Limits) -> tuple[tuple[Frame, ...], Vector]:
        """All four frames of torques (16,), N·m, with at most `limits` counts each, (16,); and what the hand makes of
        them, (16,), N·m. Raises ProtocolError for NaN."""
        counts = torque * self._scales
        counts += np.copysign(_EPSILON, counts)
        counts = _within(np.trunc(counts, out=counts), -limits, limits)
        sent = counts[_TURNED] if self._backwards else counts
        return _cut(self.identifiers, sent.astype(self._word).tobytes()), counts * self._worths

    def frame(self, finger: int, four: Four) -> Frame:
        """A finger's frame, with at most full scale. Raises ProtocolError for NaN."""
        first = 4 * finger
        counts = [truncated(four[k] * self._scale[first + k], self._limit) for k in range(4)]
        return Frame(self.identifiers[finger], self._one.pack(*(reversed(counts) if self._backwards else counts)))


def _cut(identifiers: Sequence[int], data: bytes) -> tuple[Frame, ...]:
    a, b, c, d = identifiers
    new = tuple.__new__  # Four frames a period each way: a NamedTuple's own constructor takes four times as long.
    return (
        new(Frame, (a, data[:8], False)),
        new(Frame, (b, data[8:16], False)),
        new(Frame, (c, data[16:24], False)),
        new(Frame, (d, data[24:], False)),
    )


def _within(counts: Vector, low: float | Limits, high: float | Limits) -> Vector:
    """Inside what the wire can say. Raises ProtocolError for NaN."""
    if isnan(counts @ counts):
        raise ProtocolError("NaN cannot be put on the wire")
    return np.minimum(np.maximum(counts, low, out=counts), high, out=counts)
