"""The solves that a control loop calls: a finger with its pitch and the thumb with q₀, as functions over constants.

A call costs as much as a sine, an attribute a third of that: so each is written out, and its constants are variables of
the function around it. With d the distance of two links' end, outer = (l₁ + l₂)² and inner = (l₁ - l₂)²:
u = tan(ε/2) = √((outer - d²) / (d² - inner)), as in `planar.two_link`, and by the law of tangents the lead of the first
link is λ = ε/2 - atan(u (l₁ - l₂) / (l₁ + l₂)), which needs no second root.
"""

from __future__ import annotations

from math import atan, atan2, copysign, cos, inf, isfinite, pi, sin, sqrt, tan
from typing import NamedTuple, Protocol

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.closed_form.forms.maths import FLOATS
from allegro_twin.kinematics.closed_form.forms.planar import TOUCH

Posture = tuple[float, float, float, float]
"""Joints from the palm outward, rad."""
Ranges = tuple[tuple[float, float], ...]
"""Lowest and highest of the four joints, rad."""


class Solve(Protocol):
    """One way to solve: x, y, z, m, and the angle that is held, rad, to the postures `margin` inside the limits.

    Raises ConfigError for a number that is not finite.
    """

    def __call__(self, x: float, y: float, z: float, angle: float, /, margin: float = 0.0) -> list[Posture]: ...


class Reach(NamedTuple):
    """Two links and the limits of the elbow ε between them, as bounds of d², m²."""

    even: float
    """(l₁ - l₂) / (l₁ + l₂)."""
    inner: float
    outer: float
    least: float
    most: float
    raised: float
    """From here on ε ≥ 0 is inside its limits."""
    lowered: float
    """From here on ε ≤ 0 is."""


def reach_of(first: float, second: float, low: float, high: float) -> Reach:
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
    return Reach((first - second) / (first + second), inner, outer, min(raised, lowered), most, raised, lowered)


def lead_of(reach: Reach, elbow: float) -> float:
    """λ of an elbow, rad."""
    return elbow / 2 - atan(reach.even * tan(elbow / 2))


def finger_at_pitch(rows: tuple[float, ...], tip: float, reach: Reach, limits: Ranges, sign: float) -> Solve:
    """With φ = q₁ + q₂ + q₃. `rows` lead into the base frame at joint 1; q₀ is `sign` times that of the right hand."""
    a, b, c, u, d, e, f, v, g, h, i, w = rows
    even, inner, outer, least, most, raised, lowered = reach
    (l0, h0), (l1, h1), _, (l3, h3) = limits
    l0, h0 = sorted((l0 * sign, h0 * sign))

    def at_pitch(px: float, py: float, pz: float, pitch: float, /, margin: float = 0.0) -> list[Posture]:
        x, y, z = a * px + b * py + c * pz - u, d * px + e * py + f * pz - v, g * px + h * py + i * pz - w
        r = sqrt(x * x + y * y)
        q0 = atan2(y, x) if r > TOUCH else 0.0
        if q0 < l0 or q0 > h0:  # The limits of q₀ leave at most one side of the abduction axis.
            q0, r = q0 - copysign(pi, q0), -r
            if q0 < l0 or q0 > h0:
                return none(px, py, pz, pitch)
        try:
            r, z = r - tip * sin(pitch), z - tip * cos(pitch)
        except ValueError:
            return none(px, py, pz, pitch)
        square = r * r + z * z
        if not least <= square <= most:
            return none(px, py, pz, pitch)
        bend = (outer - square) / (square - inner)
        bend = sqrt(bend) if bend > 0.0 else 0.0
        half, towards = atan(bend), atan2(r, z)
        lead, elbow = half - atan(even * bend), half + half
        q0 *= sign
        found: list[Posture] = []
        if square >= raised:
            q1 = towards - lead
            q3 = pitch - q1 - elbow
            q3 = q3 if l3 <= q3 <= h3 else turned(q3, l3, h3)
            if l1 <= q1 <= h1 and l3 <= q3 <= h3:
                found.append((q0, q1, elbow, q3))
        if square >= lowered:
            q1 = towards + lead
            q3 = pitch - q1 + elbow
            q3 = q3 if l3 <= q3 <= h3 else turned(q3, l3, h3)
            if l1 <= q1 <= h1 and l3 <= q3 <= h3:
                found.append((q0, q1, -elbow, q3))
        return found if margin == 0.0 else clear(found, limits, margin)

    return at_pitch


def thumb_at_q0(rows: tuple[float, ...], aside: float, up: float, reach: Reach, limits: Ranges) -> Solve:
    """With q₀. `rows` lead into the base frame, along x to joint 1, which is `aside` in y and, with its rise, `up`."""
    a, b, c, u, d, e, f, v, g, h, i, w = rows
    even, inner, outer, least, most, raised, lowered = reach
    (l0, h0), (l1, h1), (l2, h2), _ = limits

    def at_q0(px: float, py: float, pz: float, q0: float, /, margin: float = 0.0) -> list[Posture]:
        try:
            s, t = sin(q0), cos(q0)
        except ValueError:
            return none(px, py, pz, q0)
        across, along = d * px + e * py + f * pz - v, g * px + h * py + i * pz - w
        x, y, z = a * px + b * py + c * pz - u, t * across - s * along - aside, s * across + t * along - up
        square = x * x + y * y
        r = sqrt(square)
        square += z * z
        if not least <= square <= most:
            return none(px, py, pz, q0)
        q1 = atan2(y, x) if r > TOUCH else 0.0
        if q1 < l1 or q1 > h1:  # The limits of q₁ leave at most one side of its axis.
            q1, r = q1 - copysign(pi, q1), -r
            if q1 < l1 or q1 > h1:
                return []
        if q0 < l0 or q0 > h0:
            q0 = turned(q0, l0, h0)
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
        return found if margin == 0.0 else clear(found, limits, margin)

    return at_q0


def none(x: float, y: float, z: float, angle: float) -> list[Posture]:
    """No posture. Raises ConfigError if that is because a number is not finite."""
    for name, value in (("x", x), ("y", y), ("z", z), ("the angle", angle)):
        if not isfinite(value):
            raise ConfigError(f"{name} must be finite; it is {value}")
    return []


def turned(angle: float, low: float, high: float) -> float:
    """The same angle within π of the middle of its range."""
    return FLOATS.turned(angle, (low + high) / 2)


def clear(found: list[Posture], limits: Ranges, margin: float) -> list[Posture]:
    """Those of the postures that keep `margin` from the limits, rad."""
    return [
        q
        for q in found
        if all(low + margin <= angle <= high - margin for angle, (low, high) in zip(q, limits, strict=True))
    ]
