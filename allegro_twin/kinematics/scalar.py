"""One target at a time on plain numbers, for a control loop: the same closed forms without an array in sight."""

from __future__ import annotations

import math
from math import atan2, cos, hypot, sin, sqrt

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.family import TOLERANCE
from allegro_twin.kinematics.geometry import Geometry
from allegro_twin.kinematics.planar import TOUCH
from allegro_twin.kinematics.scalar_quartic import solve_fixed_bend
from allegro_twin.types import Vector

Posture = tuple[float, float, float, float]
"""Joints from the palm outward, rad."""


class ScalarKinematics:
    """Forward and inverse of one finger in its hand's palm frame; m and rad. Unreachable targets give no posture."""

    def __init__(self, geometry: Geometry, lower: Vector, upper: Vector, signs: Vector, *, left: bool) -> None:
        self._thumb, self._links, self._rise = geometry.is_thumb, geometry.links, geometry.rise
        self._origin = tuple(map(float, geometry.origin))
        self._base = tuple(map(float, geometry.base.ravel()))
        self._offset = tuple(map(float, geometry.offset))
        self._limits = list(zip(map(float, lower), map(float, upper), map(float, signs), strict=True))
        self._mirror = -1.0 if left else 1.0

    def fk(self, q0: float, q1: float, q2: float, q3: float) -> tuple[float, float, float]:
        """The fingertip, m."""
        q0, q1, q2, q3 = (q * s for q, (_, _, s) in zip((q0, q1, q2, q3), self._limits, strict=True))
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
        """A finger's postures inside the limits, with φ = q₁ + q₂ + q₃."""
        if self._thumb:
            raise ConfigError("the thumb has no pitch; use at_q0, at_q1 or at_psi")
        x, y, z = self._in_base(x, y, z)
        first, second, tip = self._links
        reach, turn = hypot(x, y), atan2(y, x)
        if reach <= TOUCH:
            turn = 0.0
        across, height = tip * sin(pitch), z - self._offset[2] - tip * cos(pitch)
        found: list[Posture] = []
        for r, q0 in ((reach, turn), (-reach, turn + math.pi)):
            if self._outside(0, q0, margin):
                continue
            for q1, q2 in _two_link(r - across, height, first, second):
                self._keep(found, (q0, q1, q2, pitch - q1 - q2), margin)
        return found

    def at_q0(self, x: float, y: float, z: float, q0: float, margin: float = 0.0) -> list[Posture]:
        """The thumb's postures inside the limits, with q₀."""
        self._needs_thumb()
        x, y, z = self._in_base(x, y, z)
        q0 *= self._limits[0][2]
        c, s = cos(q0), sin(q0)
        wx, wy = x - self._offset[0], c * y - s * z - self._offset[1]
        height = s * y + c * z - self._offset[2] - self._rise
        reach = hypot(wx, wy)
        turn = 0.0 if reach <= TOUCH else atan2(wy, wx)
        found: list[Posture] = []
        for r, q1 in ((reach, turn), (-reach, turn + math.pi)):
            for q2, q3 in _two_link(r, height, *self._links):
                self._keep(found, (q0, q1, q2, q3), margin)
        return found

    def at_q1(self, x: float, y: float, z: float, q1: float, margin: float = 0.0) -> list[Posture]:
        """The thumb's postures inside the limits, with q₁."""
        self._needs_thumb()
        x, y, z = self._in_base(x, y, z)
        q1 *= self._limits[1][2]
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
            for q2, q3 in _two_link(r, vz - self._offset[2] - self._rise, *self._links):
                self._keep(found, (q0, q1, q2, q3), margin)
        return found

    def at_psi(self, x: float, y: float, z: float, psi: float, margin: float = 0.0) -> list[Posture]:
        """The thumb's postures inside the limits, with ψ = q₂ + q₃."""
        self._needs_thumb()
        x, y, z = self._in_base(x, y, z)
        (ax, ay, az), (link, tip) = self._offset, self._links
        up = az + self._rise + tip * cos(psi)
        low, high, _ = self._limits[2]
        found: list[Posture] = []
        for theta, q0, q1 in solve_fixed_bend(x - ax, y, z, ay, link, tip * sin(psi), up, low, high):
            self._keep(found, (q0, q1, theta, psi - theta), margin)
        return found

    def _needs_thumb(self) -> None:
        if not self._thumb:
            raise ConfigError("only the thumb is solved with q0, q1 or psi; use at_pitch")

    def _in_base(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        b, (ox, oy, oz) = self._base, self._origin
        x, y, z = x - ox, self._mirror * y - oy, z - oz
        return b[0] * x + b[3] * y + b[6] * z, b[1] * x + b[4] * y + b[7] * z, b[2] * x + b[5] * y + b[8] * z

    def _outside(self, joint: int, angle: float, margin: float) -> bool:
        low, high, sign = self._limits[joint]
        turned = _turned(angle * sign, low, high)
        return turned < low + margin - TOLERANCE or turned > high - margin + TOLERANCE

    def _keep(self, found: list[Posture], posture: Posture, margin: float) -> None:
        """Add a posture of the right hand, as this hand's, if it is inside the limits."""
        kept = []
        for angle, (low, high, sign) in zip(posture, self._limits, strict=True):
            turned = _turned(angle * sign, low, high)
            if turned < low + margin - TOLERANCE or turned > high - margin + TOLERANCE:
                return
            kept.append(turned)
        found.append((kept[0], kept[1], kept[2], kept[3]))


def _turned(angle: float, low: float, high: float) -> float:
    """The same angle within π of the middle of its range."""
    middle = (low + high) / 2
    if -math.pi <= angle - middle <= math.pi:
        return angle
    return angle - 2 * math.pi * round((angle - middle) / (2 * math.pi))


def _two_link(r: float, h: float, first: float, second: float) -> tuple[tuple[float, float], ...]:
    """Both postures of two links, first angle and elbow, as `planar.two_link`; none where out of reach."""
    square = r * r + h * h
    outer, inner = first + second, abs(first - second)
    straight, folded = outer * outer - square, square - inner * inner
    if straight < -2 * outer * TOUCH or folded < -2 * inner * TOUCH:
        return ()
    straight, folded = max(straight, 0.0), max(folded, 0.0)
    a, b = sqrt(straight), sqrt(folded)
    lead = atan2(a * b / (2 * first), first + (folded - straight) / (4 * first))
    elbow, towards = 2.0 * atan2(a, b), atan2(r, h)
    return (towards - lead, elbow), (towards + lead, -elbow)
