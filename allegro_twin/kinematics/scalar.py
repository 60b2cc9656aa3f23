"""One target at a time on plain numbers, for a control loop: the same closed forms without an array in sight."""

from __future__ import annotations

from math import atan2, copysign, cos, hypot, pi, sin, sqrt

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.family import TOLERANCE
from allegro_twin.kinematics.geometry import Geometry
from allegro_twin.kinematics.planar import TOUCH
from allegro_twin.kinematics.scalar_quartic import solve_fixed_bend
from allegro_twin.types import Vector

Links = tuple[float, float, float, float, float, float, float]
"""Of two links: l₁, 1/2l₁, 1/4l₁, (l₁ + l₂)², (l₁ - l₂)², and the least and the largest d² that count as reached."""
Posture = tuple[float, float, float, float]
"""Joints from the palm outward, rad."""


class ScalarKinematics:
    """Forward and inverse of one finger in its hand's palm frame; m and rad. Unreachable targets give no posture."""

    def __init__(self, geometry: Geometry, lower: Vector, upper: Vector, signs: Vector, *, left: bool) -> None:
        self._thumb, self._links, self._rise = geometry.is_thumb, geometry.links, geometry.rise
        self._origin = tuple(map(float, geometry.origin))
        self._base = tuple(map(float, geometry.base.ravel()))
        self._offset = tuple(map(float, geometry.offset))
        self._signs = tuple(map(float, signs))
        ends = [sorted((float(a * s), float(b * s))) for a, b, s in zip(lower, upper, signs, strict=True)]
        self._bounds = tuple((low, high, (low + high) / 2) for low, high in ends)  # Those of the right hand.
        self._sign = self._signs[0]  # No other joint ever changes sign.
        if self._signs[1:] != (1.0, 1.0, 1.0):
            raise ConfigError(f"only joint 0 of a finger may be mirrored by its sign; these are {self._signs}")
        self._mirror = -1.0 if left else 1.0
        self._pair = _links(*self._links[:2])
        self._inside = self._shrunk(0.0)
        if any(high - low >= pi for low, high, _ in self._bounds):
            raise ConfigError("the scalar forms need every joint to turn by less than half a turn")
        # The way into the base frame, row by row, its shift behind each row; for a finger from the knuckle of joint 1.
        into, (ax, ay, az) = geometry.base.T * [1.0, self._mirror, 1.0], self._offset
        shift = geometry.base.T @ geometry.origin + (0.0 if self._thumb else geometry.offset)
        rows = tuple(float(value) for row, end in zip(into, shift, strict=True) for value in (*row, end))
        own = (ax, ay, az + self._rise) if self._thumb else (self._links[2],)
        self._flat = (*rows, *own, *self._pair)

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

    def at_pitch(self, x: float, y: float, z: float, pitch: float, margin: float = 0.0) -> list[Posture]:
        """A finger's postures inside the limits, with φ = q₁ + q₂ + q₃. Written out: a call costs as much as a sine."""
        if self._thumb:
            raise ConfigError("the thumb has no pitch; use at_q0, at_q1 or at_psi")
        l0, h0, l1, h1, l2, h2, l3, h3 = self._inside if margin == 0.0 else self._shrunk(margin)
        a, b, c, u, d, e, f, v, g, h, i, w, tip, first, half, quarter, outer, inner, near, far = self._flat
        x, y, z = a * x + b * y + c * z - u, d * x + e * y + f * z - v, g * x + h * y + i * z - w
        r, q0 = sqrt(x * x + y * y), atan2(y, x)
        if r <= TOUCH:
            q0 = 0.0
        if not l0 <= q0 <= h0:  # The limits of q₀ leave at most one side of the abduction axis.
            q0, r = q0 - copysign(pi, q0), -r
            if not l0 <= q0 <= h0:
                return []
        r, z = r - tip * sin(pitch), z - tip * cos(pitch)
        square = r * r + z * z
        if not near <= square <= far:
            return []
        straight, folded = outer - square, square - inner
        s, t = sqrt(straight) if straight > 0.0 else 0.0, sqrt(folded) if folded > 0.0 else 0.0
        towards, lead, elbow = (
            atan2(r, z),
            atan2(s * t * half, first + (folded - straight) * quarter),
            2.0 * atan2(s, t),
        )
        found: list[Posture] = []
        q0 *= self._sign
        for q1, q2 in ((towards - lead, elbow), (towards + lead, -elbow)):
            if l2 <= q2 <= h2:
                q1 = q1 if l1 <= q1 <= h1 else _turned(q1, l1, h1)
                q3 = pitch - q1 - q2
                q3 = q3 if l3 <= q3 <= h3 else _turned(q3, l3, h3)
                if l1 <= q1 <= h1 and l3 <= q3 <= h3:
                    found.append((q0, q1, q2, q3))
        return found

    def at_q0(self, x: float, y: float, z: float, q0: float, margin: float = 0.0) -> list[Posture]:
        """The thumb's postures inside the limits, with q₀. Written out: a call costs as much as a sine."""
        self._needs_thumb()
        l0, h0, l1, h1, l2, h2, l3, h3 = self._inside if margin == 0.0 else self._shrunk(margin)
        a, b, c, u, d, e, f, v, g, h, i, w, ax, ay, up, first, half, quarter, outer, inner, near, far = self._flat
        x, y, z = a * x + b * y + c * z - u, d * x + e * y + f * z - v, g * x + h * y + i * z - w
        s, t = sin(q0), cos(q0)
        x, y, z = x - ax, t * y - s * z - ay, s * y + t * z - up
        square = x * x + y * y
        r, q1 = sqrt(square), atan2(y, x)
        if r <= TOUCH:
            q1 = 0.0
        if not l1 <= q1 <= h1:  # The limits of q₁ leave at most one side of its axis.
            q1, r = q1 - copysign(pi, q1), -r
        q0 = q0 if l0 <= q0 <= h0 else _turned(q0, l0, h0)
        square += z * z
        if not (l0 <= q0 <= h0 and l1 <= q1 <= h1 and near <= square <= far):
            return []
        straight, folded = outer - square, square - inner
        s, t = sqrt(straight) if straight > 0.0 else 0.0, sqrt(folded) if folded > 0.0 else 0.0
        towards, lead, elbow = (
            atan2(r, z),
            atan2(s * t * half, first + (folded - straight) * quarter),
            2.0 * atan2(s, t),
        )
        found: list[Posture] = []
        for q2, q3 in ((towards - lead, elbow), (towards + lead, -elbow)):
            if l3 <= q3 <= h3:
                q2 = q2 if l2 <= q2 <= h2 else _turned(q2, l2, h2)
                if l2 <= q2 <= h2:
                    found.append((q0, q1, q2, q3))
        return found

    def at_q1(self, x: float, y: float, z: float, q1: float, margin: float = 0.0) -> list[Posture]:
        """The thumb's postures inside the limits, with q₁."""
        self._needs_thumb()
        x, y, z = self._in_base(x, y, z)
        r = (x - self._offset[0]) / cos(q1)
        across = self._offset[1] + r * sin(q1)
        radius = hypot(y, z)
        square = (radius - across) * (radius + across)
        if square < -2 * radius * TOUCH:
            return []
        up = sqrt(max(square, 0.0))
        found: list[Posture] = []
        for vz in (up, -up):
            q0 = atan2(vz, across) - atan2(z, y)
            if _fitted(q0, self._bounds[0], margin) is not None:
                self._both(found, q0, q1, r, vz - self._offset[2] - self._rise, margin)
        return found

    def at_psi(self, x: float, y: float, z: float, psi: float, margin: float = 0.0) -> list[Posture]:
        """The thumb's postures inside the limits, with ψ = q₂ + q₃."""
        self._needs_thumb()
        x, y, z = self._in_base(x, y, z)
        (ax, ay, az), (link, tip) = self._offset, self._links
        up = az + self._rise + tip * cos(psi)
        low, high, _ = self._bounds[2]
        found: list[Posture] = []
        for theta, q0, q1 in solve_fixed_bend(x - ax, y, z, ay, link, tip * sin(psi), up, low, high):
            self._keep(found, q0, q1, theta, psi - theta, margin)
        return found

    def _needs_thumb(self) -> None:
        if not self._thumb:
            raise ConfigError("only the thumb is solved with q0, q1 or psi; use at_pitch")

    def _in_base(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        b, (ox, oy, oz) = self._base, self._origin
        x, y, z = x - ox, self._mirror * y - oy, z - oz
        return b[0] * x + b[3] * y + b[6] * z, b[1] * x + b[4] * y + b[7] * z, b[2] * x + b[5] * y + b[8] * z

    def _shrunk(self, margin: float) -> tuple[float, ...]:
        """Lowest and highest of each joint in turn, of the right hand, less the margin and with the tolerance."""
        slack = TOLERANCE - margin
        return tuple(end for low, high, _ in self._bounds for end in (low - slack, high + slack))

    def _both(self, found: list[Posture], q0: float, q1: float, r: float, h: float, margin: float) -> None:
        """Add the thumb's two elbows, where they are inside the limits."""
        bend = _two_link(r, h, self._pair)
        if bend is not None:
            towards, lead, elbow = bend
            self._keep(found, q0, q1, towards - lead, elbow, margin)
            self._keep(found, q0, q1, towards + lead, -elbow, margin)

    def _keep(self, found: list[Posture], q0: float, q1: float, q2: float, q3: float, margin: float) -> None:
        """Add a posture of the right hand, as this hand's, if it is inside the limits."""
        b0, b1, b2, b3 = self._bounds
        k2 = _fitted(q2, b2, margin)
        if k2 is None:
            return
        k3 = _fitted(q3, b3, margin)
        if k3 is None:
            return
        k1, k0 = _fitted(q1, b1, margin), _fitted(q0, b0, margin)
        if k1 is not None and k0 is not None:
            found.append((k0 * self._sign, k1, k2, k3))


def _turned(angle: float, low: float, high: float) -> float:
    """The same angle within π of the middle of its range."""
    away = angle - (low + high) / 2
    return angle if -pi <= away <= pi else angle - 2 * pi * round(away / (2 * pi))


def _fitted(angle: float, bounds: tuple[float, float, float], margin: float) -> float | None:
    """The same angle inside its bounds (low, high, middle) less the margin; none if no full turn brings it there."""
    low, high, middle = bounds
    slack = TOLERANCE - margin
    if low - slack <= angle <= high + slack:
        return angle
    away = angle - middle
    if -pi <= away <= pi:
        return None
    angle -= 2 * pi * round(away / (2 * pi))
    return angle if low - slack <= angle <= high + slack else None


def _links(first: float, second: float) -> Links:
    outer, inner = first + second, abs(first - second)
    near, far = inner * inner - 2 * inner * TOUCH, outer * outer + 2 * outer * TOUCH
    return first, 1 / (2 * first), 1 / (4 * first), outer * outer, inner * inner, near, far


def _two_link(r: float, h: float, links: Links) -> tuple[float, float, float] | None:
    """`planar.two_link`: towards, lead and elbow; none where out of reach."""
    first, half, quarter, outer, inner, near, far = links
    square = r * r + h * h
    if not near <= square <= far:
        return None
    straight, folded = outer - square, square - inner
    if straight < 0.0:
        straight = 0.0
    if folded < 0.0:
        folded = 0.0
    a, b = sqrt(straight), sqrt(folded)
    return atan2(r, h), atan2(a * b * half, first + (folded - straight) * quarter), 2.0 * atan2(a, b)
