"""Inverse kinematics of one target on plain numbers, for a control loop: the same closed forms without arrays.

A call costs as much as a few sines, an attribute a third of a sine. So the two solves that a control loop calls, a
finger with its pitch and the thumb with q₀, are functions whose constants are variables of the function around them.
With outer = (l₁ + l₂)² and inner = (l₁ - l₂)²: u = tan(ε/2) = √((outer - d²) / (d² - inner)), and by the law of
tangents the lead of the first link is λ = ε/2 - atan(u (l₁ - l₂) / (l₁ + l₂)), which needs no second root.
"""

from __future__ import annotations

from math import atan, atan2, copysign, cos, hypot, inf, isfinite, pi, sin, sqrt, tan
from typing import NamedTuple, Protocol

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.closed_form.forms.quartic import FixedBend
from allegro_twin.kinematics.closed_form.forms.two_links import TOLERANCE, TOUCH
from allegro_twin.kinematics.closed_form.geometry import Geometry
from allegro_twin.kinematics.maths import FLOATS
from allegro_twin.types import Vector

Posture = tuple[float, float, float, float]
"""Joints from the palm outward, rad."""
Ranges = tuple[tuple[float, float], ...]
"""Lowest and highest of the four joints, rad."""


class Solve(Protocol):
    """Solver from x, y, z, m, and the held angle, rad, to the postures that keep `margin` from the limits, rad.

    Raises ConfigError for a number that is not finite.
    """

    def __call__(self, x: float, y: float, z: float, angle: float, /, margin: float = 0.0) -> list[Posture]: ...


_ONLY_THUMB = "only the thumb is solved with q0, q1 or psi; use at_pitch"


class ScalarKinematics:
    """Forward and inverse kinematics of one finger in its hand's palm frame; m and rad. A target out of reach has no
    posture."""

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
        self._elbow_limits = _elbow_limits(self._links[0], self._links[1], *limits[elbow])
        furthest = max(map(abs, limits[first])) + _lead(self._elbow_limits, max(map(abs, limits[elbow])))
        if furthest >= pi or any(high - low >= pi for low, high in limits):  # No full turn ever needs undoing.
            raise ConfigError("the scalar forms need every joint to turn by less than half a turn")
        rows = _rows(geometry, self._mirror)
        if self._thumb:
            self.at_q0 = _thumb_at_q0(rows, self._offset[1], self._offset[2] + self._rise, self._elbow_limits, limits)
            self.at_pitch = _refuse_with("the thumb has no pitch; use at_q0, at_q1 or at_psi")
        else:
            self.at_pitch = _finger_at_pitch(rows, self._links[2], self._elbow_limits, limits, self._sign)
            self.at_q0 = _refuse_with(_ONLY_THUMB)

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
        _no_posture(x, y, z, q1)
        (l0, h0), (l1, h1), _, _ = self._limits
        x, y, z = self._in_base(x, y, z)
        r = (x - self._offset[0]) / cos(q1)
        across = self._offset[1] + r * sin(q1)
        radius = hypot(y, z)
        square = (radius - across) * (radius + across)
        q1 = q1 if l1 <= q1 <= h1 else _wrap(q1, l1, h1)
        if square < -2 * radius * TOUCH or not l1 <= q1 <= h1:
            return []
        up, lean = sqrt(square) if square > 0.0 else 0.0, atan2(z, y)
        found: list[Posture] = []
        for vz in (up, -up):
            q0 = atan2(vz, across) - lean
            q0 = q0 if l0 <= q0 <= h0 else _wrap(q0, l0, h0)
            if l0 <= q0 <= h0:
                for q2, q3 in self._elbows(r, vz - self._offset[2] - self._rise):
                    found.append((q0, q1, q2, q3))
        return found if margin == 0.0 else _keep_margin(found, self._limits, margin)

    def at_psi(self, x: float, y: float, z: float, psi: float, margin: float = 0.0) -> list[Posture]:
        """The thumb's postures inside the limits, with ψ = q₂ + q₃."""
        self._needs_thumb()
        _no_posture(x, y, z, psi)
        (l0, h0), (l1, h1), (l2, h2), (l3, h3) = self._limits
        x, y, z = self._in_base(x, y, z)
        (ax, ay, az), (link, tip) = self._offset, self._links
        up = az + self._rise + tip * cos(psi)
        found: list[Posture] = []
        for q2, q0, q1 in FixedBend(FLOATS, (x - ax, y, z), ay, link, tip * sin(psi), up).roots():
            q0, q1, q3 = _wrap(q0, l0, h0), _wrap(q1, l1, h1), _wrap(psi - q2, l3, h3)
            if l0 <= q0 <= h0 and l1 <= q1 <= h1 and l2 <= q2 <= h2 and l3 <= q3 <= h3:
                found.append((q0, q1, q2, q3))
        return found if margin == 0.0 else _keep_margin(found, self._limits, margin)

    def _needs_thumb(self) -> None:
        if not self._thumb:
            raise ConfigError(_ONLY_THUMB)

    def _in_base(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        b, (ox, oy, oz) = self._base, self._origin
        x, y, z = x - ox, self._mirror * y - oy, z - oz
        return b[0] * x + b[3] * y + b[6] * z, b[1] * x + b[4] * y + b[7] * z, b[2] * x + b[5] * y + b[8] * z

    def _elbows(self, r: float, h: float) -> list[tuple[float, float]]:
        """The thumb's q₂ and q₃ inside the limits that bring its tip to (r, h)."""
        even, inner, outer, least, most, raised, lowered = self._elbow_limits
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
    """The transform into the base frame, row by row with its shift: to joint 1, of the thumb along x alone."""
    into = geometry.base.T * [1.0, mirror, 1.0]
    shift = geometry.base.T @ geometry.origin + geometry.offset * ([1.0, 0.0, 0.0] if geometry.is_thumb else 1.0)
    return tuple(float(value) for row, end in zip(into, shift, strict=True) for value in (*row, end))


def _widened(lower: Vector, upper: Vector) -> Ranges:
    """The limits widened by what still counts as on them."""
    return tuple((float(low) - TOLERANCE, float(high) + TOLERANCE) for low, high in zip(lower, upper, strict=True))


def _refuse_with(message: str) -> Solve:
    def refuse(x: float, y: float, z: float, angle: float, /, margin: float = 0.0) -> list[Posture]:
        raise ConfigError(message)

    return refuse


class ElbowLimits(NamedTuple):
    """Two links and the limits of the elbow ε between them, as bounds of d², m²."""

    even: float
    """(l₁ - l₂) / (l₁ + l₂)."""
    inner: float
    outer: float
    least: float
    most: float
    raised: float
    """The least d² at which ε ≥ 0 is inside its limits."""
    lowered: float
    """The least d² at which ε ≤ 0 is."""


def _elbow_limits(first: float, second: float, low: float, high: float) -> ElbowLimits:
    """Links in m, the elbow's limits in rad."""
    if not -pi < low <= high < pi:
        raise ConfigError(
            f"the scalar forms need an elbow that cannot fold; its limits are {low:.3f} and {high:.3f} rad"
        )

    def square(elbow: float) -> float:
        return first * first + second * second + 2 * first * second * cos(elbow)

    raised, lowered = square(high) if high >= 0 else inf, square(low) if low <= 0 else inf
    inner, outer = (first - second) ** 2, (first + second) ** 2
    most = outer + 2 * (first + second) * TOUCH if low <= 0 <= high else square(min(abs(low), abs(high)))
    return ElbowLimits((first - second) / (first + second), inner, outer, min(raised, lowered), most, raised, lowered)


def _lead(elbows: ElbowLimits, elbow: float) -> float:
    """λ of an elbow, rad."""
    return elbow / 2 - atan(elbows.even * tan(elbow / 2))


def _finger_at_pitch(rows: tuple[float, ...], tip: float, elbows: ElbowLimits, limits: Ranges, sign: float) -> Solve:
    """With φ = q₁ + q₂ + q₃. `rows` lead into the base frame at joint 1; q₀ is `sign` times that of the right hand."""
    a, b, c, u, d, e, f, v, g, h, i, w = rows
    even, inner, outer, least, most, raised, lowered = elbows
    (l0, h0), (l1, h1), _, (l3, h3) = limits
    l0, h0 = sorted((l0 * sign, h0 * sign))

    def at_pitch(px: float, py: float, pz: float, pitch: float, /, margin: float = 0.0) -> list[Posture]:
        x, y, z = a * px + b * py + c * pz - u, d * px + e * py + f * pz - v, g * px + h * py + i * pz - w
        r = sqrt(x * x + y * y)
        q0 = atan2(y, x) if r > TOUCH else 0.0
        if q0 < l0 or q0 > h0:  # The limits of q₀ leave at most one side of the abduction axis.
            q0, r = q0 - copysign(pi, q0), -r
            if q0 < l0 or q0 > h0:
                return _no_posture(px, py, pz, pitch)
        try:
            r, z = r - tip * sin(pitch), z - tip * cos(pitch)
        except ValueError:
            return _no_posture(px, py, pz, pitch)
        square = r * r + z * z
        if not least <= square <= most:
            return _no_posture(px, py, pz, pitch)
        bend = (outer - square) / (square - inner)
        bend = sqrt(bend) if bend > 0.0 else 0.0
        half, towards = atan(bend), atan2(r, z)
        lead, elbow = half - atan(even * bend), half + half
        q0 *= sign
        found: list[Posture] = []
        if square >= raised:
            q1 = towards - lead
            q3 = pitch - q1 - elbow
            q3 = q3 if l3 <= q3 <= h3 else _wrap(q3, l3, h3)
            if l1 <= q1 <= h1 and l3 <= q3 <= h3:
                found.append((q0, q1, elbow, q3))
        if square >= lowered:
            q1 = towards + lead
            q3 = pitch - q1 + elbow
            q3 = q3 if l3 <= q3 <= h3 else _wrap(q3, l3, h3)
            if l1 <= q1 <= h1 and l3 <= q3 <= h3:
                found.append((q0, q1, -elbow, q3))
        return found if margin == 0.0 else _keep_margin(found, limits, margin)

    return at_pitch


def _thumb_at_q0(rows: tuple[float, ...], aside: float, up: float, elbows: ElbowLimits, limits: Ranges) -> Solve:
    """With q₀. `rows` lead into the base frame, along x to joint 1, which is `aside` in y and, with its rise, `up`."""
    a, b, c, u, d, e, f, v, g, h, i, w = rows
    even, inner, outer, least, most, raised, lowered = elbows
    (l0, h0), (l1, h1), (l2, h2), _ = limits

    def at_q0(px: float, py: float, pz: float, q0: float, /, margin: float = 0.0) -> list[Posture]:
        try:
            s, t = sin(q0), cos(q0)
        except ValueError:
            return _no_posture(px, py, pz, q0)
        across, along = d * px + e * py + f * pz - v, g * px + h * py + i * pz - w
        x, y, z = a * px + b * py + c * pz - u, t * across - s * along - aside, s * across + t * along - up
        square = x * x + y * y
        r = sqrt(square)
        square += z * z
        if not least <= square <= most:
            return _no_posture(px, py, pz, q0)
        q1 = atan2(y, x) if r > TOUCH else 0.0
        if q1 < l1 or q1 > h1:  # The limits of q₁ leave at most one side of its axis.
            q1, r = q1 - copysign(pi, q1), -r
            if q1 < l1 or q1 > h1:
                return []
        if q0 < l0 or q0 > h0:
            q0 = _wrap(q0, l0, h0)
            if q0 < l0 or q0 > h0:
                return []
        bend = (outer - square) / (square - inner)
        bend = sqrt(bend) if bend > 0.0 else 0.0
        half, towards = atan(bend), atan2(r, z)
        lead, elbow = half - atan(even * bend), half + half
        q2 = towards - lead
        found = [(q0, q1, q2, elbow)] if square >= raised and l2 <= q2 <= h2 else []
        if square >= lowered:
            q2 = towards + lead
            if l2 <= q2 <= h2:
                found.append((q0, q1, q2, -elbow))
        return found if margin == 0.0 else _keep_margin(found, limits, margin)

    return at_q0


def _no_posture(x: float, y: float, z: float, angle: float) -> list[Posture]:
    """No posture. Raises ConfigError if that is because a number is not finite."""
    for name, value in (("x", x), ("y", y), ("z", z), ("the angle", angle)):
        if not isfinite(value):
            raise ConfigError(f"{name} must be finite; it is {value}")
    return []


def _wrap(angle: float, low: float, high: float) -> float:
    """Equivalent angle within π of the middle of its range, rad."""
    return FLOATS.wrap(angle, (low + high) / 2)


def _keep_margin(found: list[Posture], limits: Ranges, margin: float) -> list[Posture]:
    """Those of the postures that keep `margin` from the limits, rad."""
    return [
        q
        for q in found
        if all(low + margin <= angle <= high - margin for angle, (low, high) in zip(q, limits, strict=True))
    ]
