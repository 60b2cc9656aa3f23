"""The thumb in closed form: rotation about -x, then about z, then two joints that bend in one plane.

In the base frame, with ψ = q₂ + q₃, offset a, rise c and links l, t (docs/explanation/kinematics.md#thumb):
r = l sin q₂ + t sin ψ, h = c + l cos q₂ + t cos ψ, v = a + (r cos q₁, r sin q₁, h),
tip = Rx(-q₀) v, R = Rx(-q₀) Rz(q₁) Ry(ψ).
Forward, joints are rows, shape (4, ...), rad; back, every formula takes numbers or arrays (N,), x counted from aₓ.
"""

from __future__ import annotations

import numpy as np

from allegro_twin.kinematics.closed_form.forms.finger import turn_then_bend
from allegro_twin.kinematics.closed_form.forms.quartic import FixedBend
from allegro_twin.kinematics.closed_form.forms.thumb_orientation import NearestOrientation
from allegro_twin.kinematics.closed_form.forms.two_links import TOLERANCE, TOUCH, Branch, bend, two_links_of
from allegro_twin.kinematics.closed_form.geometry import Geometry
from allegro_twin.kinematics.maths import Maths, T
from allegro_twin.kinematics.orientation import Entries
from allegro_twin.types import Array, Vector

_GIMBAL = 1e-12  # Of cos q₁: below it q₀ and ψ turn about one axis.


class ThumbForms:
    """Forward and inverse in the base frame moved along x to joint 1. A target is x, y, z, m."""

    surely_nearest = 1e-7
    """A branch inside the limits with at most this angle left, rad, is turned nearest of all there, or nearly."""

    def __init__(self, geometry: Geometry, lower: Vector, upper: Vector) -> None:
        self.links = geometry.links
        self.shift = geometry.offset * [1.0, 0.0, 0.0]
        """From the base's origin to where its targets are counted from, shape (3,), m."""
        self.aside, self.up = float(geometry.offset[1]), float(geometry.offset[2]) + geometry.rise
        """a_y, and a_z + c, m."""
        self._pair = two_links_of(*self.links)
        self._middle = [float(low + high) / 2 for low, high in zip(lower, upper, strict=True)]
        bent, upright = max(0.0, -float(lower[3])) + TOLERANCE, -np.pi / 2 < lower[1] and upper[1] < np.pi / 2
        link, tip = self.links
        self._one_side = link * link + tip * tip + 2.0 * link * tip * float(np.cos(bent)) if upright else 0.0
        """d² below which only a positive elbow and cos q₁ > 0 can be inside the limits, m²."""

    def tip(self, q: Array) -> tuple[Array, Array, Array]:
        """The fingertip, shape (4, ...) → three of (...)."""
        link, tip = self.links
        psi = q[2] + q[3]
        r = link * np.sin(q[2]) + tip * np.sin(psi)
        y, z = self.aside + r * np.sin(q[1]), self.up + link * np.cos(q[2]) + tip * np.cos(psi)
        c, s = np.cos(q[0]), np.sin(q[0])
        return r * np.cos(q[1]), c * y + s * z, c * z - s * y

    def rotation(self, q: Array) -> Array:
        """R = Rx(-q₀) Rz(q₁) Ry(ψ), shape (4, ...) → (..., 3, 3)."""
        inner = turn_then_bend(q[1], q[2] + q[3])
        c, s = np.cos(q[0])[..., None], np.sin(q[0])[..., None]
        y, z = inner[..., 1, :].copy(), inner[..., 2, :].copy()
        inner[..., 1, :], inner[..., 2, :] = c * y + s * z, c * z - s * y
        return inner

    def view(self, m: Maths[T], turn: Entries[T]) -> tuple[T, ...]:
        """An orientation as its q₀, q₁ in [-π/2, π/2], ψ, rad, cos q₀ and sin q₀: R = Rx(-q₀) Rz(q₁) Ry(ψ).

        With B = Rx(q₀) R, the last row is (-sin ψ, 0, cos ψ). At q₁ = ±π/2, where q₀ and ψ are about one axis, q₀ is
        zero.
        """
        upright = m.root(turn[4] * turn[4] + turn[7] * turn[7])
        some = upright > _GIMBAL
        length = m.where(some, upright, 1.0)
        c, s = m.where(some, turn[4], 1.0) / length, m.where(some, -turn[7], 0.0) / length
        psi = m.atan2(-(s * turn[3] + c * turn[6]), s * turn[5] + c * turn[8])
        return m.atan2(s, c), m.atan2(-turn[1], upright), psi, c, s

    def angle_to(self, m: Maths[T], q: Branch[T], view: tuple[T, ...]) -> T:
        """The angle of the rotation from an orientation to that of a posture, rad, accurate near 0 and near π.

        It is that of Ry(2d) Rz(-q₁*) Rx(-2b) Rz(q₁), whose quaternion is a product of half angles.
        """
        q0, q1, q2, q3 = q
        n0, n1, n, _, _ = view
        d, b, less, more = (q2 + q3 - n) / 2.0, (q0 - n0) / 2.0, (q1 - n1) / 2.0, (q1 + n1) / 2.0
        (cd, sd), (cb, sb), (cl, sl), (cm, sm) = m.circle(d), m.circle(b), m.circle(less), m.circle(more)
        w, x, y, z = cb * cl, sb * cm, sb * sm, cb * sl
        bent = cd * y + sd * w
        return 2.0 * m.atan2(m.root(x * x + z * z + bent * bent), abs(cd * w - sd * y))

    def at_q0(self, m: Maths[T], x: T, y: T, z: T, q0: T) -> list[Branch[T]]:
        """Both sides of joint 1's axis times both elbows: four branches. On that axis q₁ is zero."""
        c, s = m.exact_circle(q0)
        return self._with_q0(m, x, y, z, m.wrap(q0, self._middle[0]), c, s, x * 0.0)

    def at_q1(self, m: Maths[T], x: T, y: T, z: T, q1: T) -> list[Branch[T]]:
        """Tip above or below the axis of joint 0, times both elbows: four branches."""
        c, s = m.exact_circle(q1)
        r = x / c
        across = self.aside + r * s
        radius, direction, q1 = m.root(y * y + z * z), m.atan2(z, y), m.wrap(q1, self._middle[1])
        square = (radius - across) * (radius + across)
        up, hole = m.root(square), m.where(square < -2.0 * radius * TOUCH, np.nan, 0.0)
        found = []
        for vz in (up, -up):
            q0 = m.wrap(m.atan2(vz, across) - direction, self._middle[0])
            found += self._bent(m, r, vz - self.up, q0 + hole, q1)
        return found

    def at_psi(self, m: Maths[T], x: T, y: T, z: T, psi: T) -> list[Branch[T]]:
        """The real roots of a quartic: at most four branches."""
        link, tip = self.links
        c, s = m.exact_circle(psi)
        bend = FixedBend(m, (x, y, z), self.aside, link, tip * s, self.up + tip * c)
        return [
            (m.wrap(q0, self._middle[0]), q1, theta, m.wrap(psi - theta, self._middle[3]))
            for theta, q0, q1 in bend.roots()
        ]

    def at_rotation(self, m: Maths[T], x: T, y: T, z: T, view: tuple[T, ...]) -> tuple[list[Branch[T]], list[T]]:
        """Position exact, q₀ that of an orientation (on joint 1's axis q₁, too), and the angle left, rad."""
        q0, q1, _, c, s = view
        found = self._with_q0(m, x, y, z, m.wrap(q0, self._middle[0]), c, s, q1)
        return found, [self.angle_to(m, branch, view) for branch in found]

    def turned_nearer(
        self, m: Maths[T], target: tuple[T, T, T], view: tuple[T, ...], angle: T
    ) -> tuple[Branch[T], T, object]:
        """The posture turned nearest to an orientation, the angle left, rad, and whether it is sure to be the nearest
        where it is inside the limits; one inside them is known to be off by `angle`, rad."""
        (x, y, z), (n0, _, _, c0, s0) = target, view
        k, sure = NearestOrientation(m, target, view, (self.aside, self.up), self.links).nearest(angle, self._one_side)
        if not m.any(sure):
            return (k, k, k, k), angle, sure
        c, s = (1.0 - k * k) / (1.0 + k * k), (k + k) / (1.0 + k * k)
        q0 = m.wrap(n0 - 2.0 * m.atan(k), self._middle[0])
        c, s = c0 * c + s0 * s, s0 * c - c0 * s
        across, height = c * y - s * z - self.aside, s * y + c * z - self.up
        side = m.copysign(k * 0.0 + 1.0, x)
        r = side * m.root(x * x + across * across)
        half, lead, _ = bend(m, r * r + height * height, self._pair)
        q = q0, m.atan2(side * across, side * x), m.atan2(r, height) - lead, half + half
        return q, self.angle_to(m, q, view), sure

    def _with_q0(self, m: Maths[T], x: T, y: T, z: T, q0: T, c: T, s: T, on_axis: T) -> list[Branch[T]]:
        """Both sides of joint 1's axis, on which one bends as the mirror image of the other, with cos q₀ and sin q₀."""
        across, height = c * y - s * z - self.aside, s * y + c * z - self.up
        flat = x * x + across * across
        reach = m.root(flat)
        half, lead, hole = bend(m, flat + height * height, self._pair)
        towards, elbow, back = m.atan2(reach, height), half + half, -half - half
        q0, q1 = q0 + hole, m.where(reach <= TOUCH, on_axis, m.atan2(across, x)) + hole
        away = q1 - m.copysign(reach * 0.0 + np.pi, q1)
        return [
            (q0, q1, towards - lead, elbow),
            (q0, q1, towards + lead, back),
            (q0, away, -towards - lead, elbow),
            (q0, away, lead - towards, back),
        ]

    def _bent(self, m: Maths[T], r: T, h: T, q0: T, q1: T) -> list[Branch[T]]:
        """Both elbows on one side."""
        half, lead, hole = bend(m, r * r + h * h, self._pair)
        towards, elbow, q0, q1 = m.atan2(r, h), half + half, q0 + hole, q1 + hole
        return [(q0, q1, towards - lead, elbow), (q0, q1, towards + lead, -elbow)]
