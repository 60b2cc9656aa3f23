"""One target at a time on plain numbers, for a control loop: the same closed forms without an array in sight."""

from __future__ import annotations

from math import atan, atan2, cos, hypot, pi, sin, sqrt

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.closed_form.forms.maths import FLOATS
from allegro_twin.kinematics.closed_form.forms.planar import TOLERANCE, TOUCH
from allegro_twin.kinematics.closed_form.forms.quartic import FixedBend
from allegro_twin.kinematics.closed_form.forms.scalar_bend import (
    Posture,
    Ranges,
    Solve,
    clear,
    finger_at_pitch,
    lead_of,
    none,
    reach_of,
    thumb_at_q0,
    turned,
)
from allegro_twin.kinematics.closed_form.geometry import Geometry
from allegro_twin.types import Vector

_ONLY_THUMB = "only the thumb is solved with q0, q1 or psi; use at_pitch"


class ScalarKinematics:
    """Forward and inverse of one finger in its hand's palm frame; m and rad. Unreachable targets give no posture."""

    at_pitch: Solve
    """A finger's postures inside the limits, with φ = q₁ + q₂ + q₃."""
    at_q0: Solve
    """The thumb's postures inside the limits, with q₀."""

    def __init__(self, geometry: Geometry, lower: Vector, upper: Vector, signs: Vector, *, left: bool) -> None:
        self._thumb, self._links, self._rise = geometry.is_thumb, geometry.links, geometry.rise
        self._origin = tuple(map(float, geometry.origin))
        self._base = tuple(map(float, geometry.base.ravel()))
        self._offset = tuple(map(float, geometry.offset))
        self._mirror = -1.0 if left else 1.0
        self._sign = float(signs[0])
        if any(sign != 1.0 for sign in signs[0 if self._thumb else 1 :]):
            raise ConfigError(f"only joint 0 of a finger may be mirrored by its sign; these are {signs.tolist()}")
        self._limits = limits = _widened(lower, upper)
        first, elbow = (2, 3) if self._thumb else (1, 2)  # Of the two links that reach.
        self._reach = reach_of(self._links[0], self._links[1], *limits[elbow])
        furthest = max(map(abs, limits[first])) + lead_of(self._reach, max(map(abs, limits[elbow])))
        if furthest >= pi or any(high - low >= pi for low, high in limits):  # No full turn ever needs undoing.
            raise ConfigError("the scalar forms need every joint to turn by less than half a turn")
        rows = _rows(geometry, self._mirror)
        if self._thumb:
            self.at_q0 = thumb_at_q0(rows, self._offset[1], self._offset[2] + self._rise, self._reach, limits)
            self.at_pitch = _refusing("the thumb has no pitch; use at_q0, at_q1 or at_psi")
        else:
            self.at_pitch = finger_at_pitch(rows, self._links[2], self._reach, limits, self._sign)
            self.at_q0 = _refusing(_ONLY_THUMB)

    def fk(self, q0: float, q1: float, q2: float, q3: float) -> tuple[float, float, float]:
        """The fingertip, m."""
        q0 *= self._sign
        ax, ay, az = self._offset
        if self._thumb:
            link, tip = self._links
            r = link * sin(q2) + tip * sin(q2 + q3)
            y, z = ay + r * sin(q1), az + self._rise + link * cos(q2) + tip * cos(q2 + q3)
            c, s = cos(q0), sin(q0)
            x, y, z = ax + r * cos(q1), c * y + s * z, c * z - s * y
        else:
            first, second, tip = self._links
            r = first * sin(q1) + second * sin(q1 + q2) + tip * sin(q1 + q2 + q3)
            z = az + first * cos(q1) + second * cos(q1 + q2) + tip * cos(q1 + q2 + q3)
            x, y = r * cos(q0), r * sin(q0)
        b, (ox, oy, oz) = self._base, self._origin
        return (
            ox + b[0] * x + b[1] * y + b[2] * z,
            self._mirror * (oy + b[3] * x + b[4] * y + b[5] * z),
            oz + b[6] * x + b[7] * y + b[8] * z,
        )

    def at_q1(self, x: float, y: float, z: float, q1: float, margin: float = 0.0) -> list[Posture]:
        """The thumb's postures inside the limits, with q₁."""
        self._needs_thumb()
        none(x, y, z, q1)
        (l0, h0), (l1, h1), _, _ = self._limits
        x, y, z = self._in_base(x, y, z)
        r = (x - self._offset[0]) / cos(q1)
        across = self._offset[1] + r * sin(q1)
        radius = hypot(y, z)
        square = (radius - across) * (radius + across)
        q1 = q1 if l1 <= q1 <= h1 else turned(q1, l1, h1)
        if square < -2 * radius * TOUCH or not l1 <= q1 <= h1:
            return []
        up, lean = sqrt(square) if square > 0.0 else 0.0, atan2(z, y)
        found: list[Posture] = []
        for vz in (up, -up):
            q0 = atan2(vz, across) - lean
            q0 = q0 if l0 <= q0 <= h0 else turned(q0, l0, h0)
            if l0 <= q0 <= h0:
                for q2, q3 in self._elbows(r, vz - self._offset[2] - self._rise):
                    found.append((q0, q1, q2, q3))
        return found if margin == 0.0 else clear(found, self._limits, margin)

    def at_psi(self, x: float, y: float, z: float, psi: float, margin: float = 0.0) -> list[Posture]:
        """The thumb's postures inside the limits, with ψ = q₂ + q₃."""
        self._needs_thumb()
        none(x, y, z, psi)
        (l0, h0), (l1, h1), (l2, h2), (l3, h3) = self._limits
        x, y, z = self._in_base(x, y, z)
        (ax, ay, az), (link, tip) = self._offset, self._links
        up = az + self._rise + tip * cos(psi)
        found: list[Posture] = []
        for q2, q0, q1 in FixedBend(FLOATS, (x - ax, y, z), ay, link, tip * sin(psi), up).roots():
            q0, q1, q3 = turned(q0, l0, h0), turned(q1, l1, h1), turned(psi - q2, l3, h3)
            if l0 <= q0 <= h0 and l1 <= q1 <= h1 and l2 <= q2 <= h2 and l3 <= q3 <= h3:
                found.append((q0, q1, q2, q3))
        return found if margin == 0.0 else clear(found, self._limits, margin)

    def _needs_thumb(self) -> None:
        if not self._thumb:
            raise ConfigError(_ONLY_THUMB)

    def _in_base(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        b, (ox, oy, oz) = self._base, self._origin
        x, y, z = x - ox, self._mirror * y - oy, z - oz
        return b[0] * x + b[3] * y + b[6] * z, b[1] * x + b[4] * y + b[7] * z, b[2] * x + b[5] * y + b[8] * z

    def _elbows(self, r: float, h: float) -> list[tuple[float, float]]:
        """The thumb's q₂ and q₃ inside the limits that bring its tip to (r, h)."""
        even, inner, outer, least, most, raised, lowered = self._reach
        low, high = self._limits[2]
        square = r * r + h * h
        if not least <= square <= most:
            return []
        bend = (outer - square) / (square - inner)
        bend = sqrt(bend) if bend > 0.0 else 0.0
        half, towards = atan(bend), atan2(r, h)
        lead = half - atan(even * bend)
        found = []
        if square >= raised and low <= towards - lead <= high:
            found.append((towards - lead, half + half))
        if square >= lowered and low <= towards + lead <= high:
            found.append((towards + lead, -half - half))
        return found


def _rows(geometry: Geometry, mirror: float) -> tuple[float, ...]:
    """The way into the base frame, row by row, its shift behind each: to joint 1, for the thumb along x alone."""
    into = geometry.base.T * [1.0, mirror, 1.0]
    shift = geometry.base.T @ geometry.origin + geometry.offset * ([1.0, 0.0, 0.0] if geometry.is_thumb else 1.0)
    return tuple(float(value) for row, end in zip(into, shift, strict=True) for value in (*row, end))


def _widened(lower: Vector, upper: Vector) -> Ranges:
    """The limits with what still counts as on them."""
    return tuple((float(low) - TOLERANCE, float(high) + TOLERANCE) for low, high in zip(lower, upper, strict=True))


def _refusing(message: str) -> Solve:
    def refuse(x: float, y: float, z: float, angle: float, /, margin: float = 0.0) -> list[Posture]:
        raise ConfigError(message)

    return refuse
