"""Sixteen values in four frames, a finger each: joint positions that come, and torques that go."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from math import floor, isnan
from struct import Struct
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from allegro_twin.drivers.can.codec.counts import nearest, truncated
from allegro_twin.drivers.can.codec.frames import Frame, JointFrames
from allegro_twin.drivers.can.codec.messages import Four
from allegro_twin.errors import ProtocolError
from allegro_twin.types import Vector, frozen

Limits: TypeAlias = Vector
Identifiers: TypeAlias = tuple[int, ...]
_EPSILON = 1e-9  # As in counts.truncated.
_new = tuple.__new__  # A NamedTuple's own constructor takes four times as long.
_TURNED = [4 * finger + joint for finger in range(4) for joint in (3, 2, 1, 0)]
"""Each finger's four the other way round."""


class Positions:
    """value = count · scale + at, in rad; counts are the nearest, inside what the wire can say."""

    def __init__(
        self,
        identifiers: Identifiers,
        kind: str,
        scale: Sequence[float],
        at: Sequence[float],
        also: Mapping[int, int] = MappingProxyType({}),
    ) -> None:
        """`kind`: of a word, as in `struct`, `h` or `H`; `scale`, `at`: rad a count and rad at count 0, 16 each;
        `also`: fingers by further identifiers that are read."""
        self.identifiers = identifiers
        self.fingers = {identifier: finger for finger, identifier in enumerate(identifiers)} | dict(also)
        """Whose report an identifier is."""
        self._one, self._all = Struct(f"<4{kind}"), Struct(f"<16{kind}")
        self._scale, self._at = tuple(scale), tuple(at)
        self._shifted = any(at)
        self._alike = scale[0] if len({*scale}) == 1 and not any(at) else 0.0
        """rad a count where that is so of every joint, and count 0 is 0 rad."""
        self._range = (0, 0xFFFF) if kind == "H" else (-0x8000, 0x7FFF)
        self._word, self._scales, self._ats = np.dtype(f"<{kind}"), np.array(scale), np.array(at)

    def values(self, data: bytes) -> Vector:
        """What the data of all four frames say, 32 bytes; read-only, (16,), rad."""
        found: Vector = np.frombuffer(data, self._word).astype(np.float64)
        found *= self._scales
        if self._shifted:
            found += self._ats
        found.setflags(write=False)
        return found

    def four(self, finger: int, data: bytes) -> Four:
        """What the data of a finger's frame say, 8 bytes."""
        first, (a, b, c, d) = 4 * finger, self._one.unpack(data)
        (p, q, r, s), (t, u, v, w) = self._scale[first : first + 4], self._at[first : first + 4]
        return (a * p + t, b * q + u, c * r + v, d * s + w)

    def frames(self, values: Vector) -> JointFrames:
        """All four frames of (16,), rad. Raises ProtocolError for NaN."""
        alike = self._alike
        try:
            if alike:
                counts = [floor(value / alike + 0.5) for value in values.tolist()]
            else:
                counts = [*map(floor, ((values - self._ats) / self._scales + 0.5).tolist())]
            return _new(JointFrames, (self.identifiers, self._all.pack(*counts), False))
        except (struct.error, OverflowError, ValueError):  # Beyond what the wire can say, infinite, or NaN.
            counts = [nearest(count, *self._range) for count in ((values - self._ats) / self._scales).tolist()]
            return JointFrames(self.identifiers, self._all.pack(*counts))

    def frame(self, finger: int, four: Four) -> Frame:
        """A finger's frame. Raises ProtocolError for NaN."""
        first, (low, high) = 4 * finger, self._range
        counts = [nearest((four[k] - self._at[first + k]) / self._scale[first + k], low, high) for k in range(4)]
        return Frame(self.identifiers[finger], self._one.pack(*counts))


class Torques:
    """count = torque · scale, N·m, cut toward zero as the manufacturer's casts do."""

    def __init__(
        self, identifiers: Identifiers, order: str, scale: Sequence[float], limit: int, *, backwards: bool = False
    ) -> None:
        """`order`: of the bytes, `<` or `>`; `scale`: counts for 1 N·m, 16; `limit`: full scale, counts; `backwards`:
        a finger's joints go from the tip to the palm."""
        self.identifiers = identifiers
        self.fingers = {identifier: finger for finger, identifier in enumerate(identifiers)}
        """Whose torques an identifier carries."""
        self._one, self._word = Struct(f"{order}4h"), np.dtype(f"{order}i2")
        self._scale, self._worth = tuple(scale), tuple(1.0 / value for value in scale)
        self._scales, self._worths = np.array(self._scale), np.array(self._worth)
        self._limit, self._backwards = limit, backwards
        self._newest = b"", frozen([])  # Data, and what they mean: in lockstep the hand reads what its driver wrote.
        self.zero = JointFrames(identifiers, bytes(32))
        """The frames that ask every motor for nothing."""

    def values(self, data: bytes) -> Vector:
        """What the data of all four frames mean, 32 bytes; read-only, (16,), N·m."""
        known, worth = self._newest
        if data is known:
            return worth
        found: Vector = np.frombuffer(data, self._word).astype(np.float64)
        if self._backwards:
            found = found[_TURNED]
        found *= self._worths
        found.setflags(write=False)
        return found

    def four(self, finger: int, data: bytes) -> Four:
        """What the data of a finger's frame mean, 8 bytes; N·m."""
        first, counts = 4 * finger, self._one.unpack(data)
        a, b, c, d = reversed(counts) if self._backwards else counts
        p, q, r, s = self._worth[first : first + 4]
        return (a * p, b * q, c * r, d * s)

    def frames(self, torque: Vector, limits: Limits) -> tuple[JointFrames, Vector]:
        """All four frames of torques (16,), N·m, with at most `limits` counts each, (16,); and what the hand makes of
        them, (16,), N·m. Raises ProtocolError for NaN."""
        counts = torque * self._scales
        sizes = np.abs(counts)
        sizes += _EPSILON
        if isnan(sum(sizes.tolist())):
            raise ProtocolError("NaN cannot be put on the wire")
        np.minimum(sizes, limits, out=sizes)
        np.trunc(np.copysign(sizes, counts, out=counts), out=counts)
        words = (counts[_TURNED] if self._backwards else counts).astype(self._word)
        counts *= self._worths
        counts.setflags(write=False)
        data = words.tobytes()
        self._newest = data, counts
        return _new(JointFrames, (self.identifiers, data, False)), counts

    def frame(self, finger: int, four: Four) -> Frame:
        """A finger's frame, with at most full scale. Raises ProtocolError for NaN."""
        first = 4 * finger
        counts = [truncated(four[k] * self._scale[first + k], self._limit) for k in range(4)]
        return Frame(self.identifiers[finger], self._one.pack(*(reversed(counts) if self._backwards else counts)))
