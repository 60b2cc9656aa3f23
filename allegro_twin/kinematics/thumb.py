"""The thumb in closed form: rotation about -x, then about z, then two joints that bend in one plane.

In the base frame, with ψ = q₂ + q₃, offset a, rise c and links l, t (docs/kinematics.md#thumb):
r = l sin q₂ + t sin ψ, h = c + l cos q₂ + t cos ψ, v = a + (r cos q₁, r sin q₁, h),
tip = Rx(-q₀) v, R = Rx(-q₀) Rz(q₁) Ry(ψ).
Joints are held as rows, shape (4, ...), rad; branches as (4, k, N).
"""

from __future__ import annotations

import numpy as np

from allegro_twin.kinematics.finger import Branches, clipped_angle, turn_then_bend
from allegro_twin.kinematics.geometry import Geometry
from allegro_twin.kinematics.planar import TOUCH, Flags, two_link
from allegro_twin.kinematics.quartic import solve_fixed_bend
from allegro_twin.types import Array


class Thumb:
    """Forward and inverse in the base frame. Targets come as coordinates x, y, z, each of shape (N,), m."""

    def __init__(self, geometry: Geometry) -> None:
        self.geometry = geometry
        self._ax, self._ay, self._az = map(float, geometry.offset)

    def tip(self, q: Array) -> tuple[Array, Array, Array]:
        """The fingertip, shape (4, ...) → three of (...)."""
        x, y, z = self._unturned(q)
        c, s = np.cos(q[0]), np.sin(q[0])
        return x, c * y + s * z, c * z - s * y

    def rotation(self, q: Array) -> Array:
        """R = Rx(-q₀) Rz(q₁) Ry(ψ), shape (4, ...) → (..., 3, 3)."""
        inner = turn_then_bend(q[1], q[2] + q[3])
        c, s = np.cos(q[0])[..., None], np.sin(q[0])[..., None]
        y, z = inner[..., 1, :].copy(), inner[..., 2, :].copy()
        inner[..., 1, :], inner[..., 2, :] = c * y + s * z, c * z - s * y
        return inner

    def turned_towards(self, q: Array, x: Array, y: Array, z: Array, lower: Array, upper: Array) -> Array:
        """The same bend with q₀, within its limits, turned to bring the tip nearest to a target."""
        _, vy, vz = self._unturned(q)
        turned: Array = q.copy()
        turned[0] = clipped_angle(np.arctan2(vz, vy) - np.arctan2(z, y), lower[0], upper[0])
        return turned

    def swung_towards(self, q: Array, x: Array, y: Array, z: Array, lower: Array, upper: Array) -> Array:
        """The same bend and q₀ with q₁, within its limits, turned to bring the tip nearest to a target."""
        r, _ = self._section(q)
        across = np.cos(q[0]) * y - np.sin(q[0]) * z - self._ay
        turned: Array = q.copy()
        towards = np.arctan2(across, x - self._ax) + np.where(r < 0, np.pi, 0.0)
        turned[1] = clipped_angle(towards, lower[1], upper[1])
        return turned

    def at_q0(self, x: Array, y: Array, z: Array, q0: Array, on_axis: Array | float = 0.0) -> Branches:
        """Both sides of joint 1's axis times both elbows: four branches. On that axis q₁ is `on_axis`."""
        c, s = np.cos(q0), np.sin(q0)
        wx, wy, height = x - self._ax, c * y - s * z - self._ay, s * y + c * z - self._az - self.geometry.rise
        reach = np.hypot(wx, wy)
        q1 = np.where(reach <= TOUCH, on_axis, np.arctan2(wy, wx))
        return self._bent(((reach, height, q0, q1, True), (-reach, height, q0, q1 + np.pi, True)))

    def at_q1(self, x: Array, y: Array, z: Array, q1: Array) -> Branches:
        """Tip above or below the axis of joint 0, times both elbows: four branches."""
        r = (x - self._ax) / np.cos(q1)
        across = self._ay + r * np.sin(q1)
        radius, direction = np.hypot(y, z), np.arctan2(z, y)
        square = (radius - across) * (radius + across)
        real = square >= -2 * radius * TOUCH
        up = np.sqrt(np.maximum(square, 0.0))
        base = self._az + self.geometry.rise
        above, below = np.arctan2(up, across) - direction, np.arctan2(-up, across) - direction
        return self._bent(((r, up - base, above, q1, real), (r, -up - base, below, q1, real)))

    def at_psi(self, x: Array, y: Array, z: Array, psi: Array) -> Branches:
        """The real roots of a quartic: at most four branches."""
        link, tip = self.geometry.links
        up = self._az + self.geometry.rise + tip * np.cos(psi)
        theta, q0, q1, real = solve_fixed_bend(x - self._ax, y, z, self._ay, link, tip * np.sin(psi), up)
        return np.stack([q0, q1, theta, psi - theta]), real

    def at_q2(self, x: Array, y: Array, z: Array, q2: Array) -> Branches:
        """As `at_psi`, with the roles of the two links exchanged."""
        link, tip = self.geometry.links
        up = self._az + self.geometry.rise + link * np.cos(q2)
        psi, q0, q1, real = solve_fixed_bend(x - self._ax, y, z, self._ay, tip, link * np.sin(q2), up)
        return np.stack([q0, q1, np.broadcast_to(q2, psi.shape), psi - q2]), real

    def at_q3(self, x: Array, y: Array, z: Array, q3: Array) -> Branches:
        """As `at_psi`, with the two links frozen into one of length |l + t exp(i q₃)|."""
        link, tip = self.geometry.links
        along, aside = link + tip * np.cos(q3), tip * np.sin(q3)
        up = np.full_like(x, self._az + self.geometry.rise)
        length, lean = np.hypot(along, aside), np.arctan2(aside, along)
        theta, q0, q1, real = solve_fixed_bend(x - self._ax, y, z, self._ay, length, np.zeros_like(x), up)
        return np.stack([q0, q1, theta - lean, np.broadcast_to(q3, theta.shape)]), real

    def at_rotation(self, x: Array, y: Array, z: Array, rotation: Array) -> Branches:
        """Position exact, q₀ the one of R, shape (N, 3, 3): q₀ = atan2(-R₂₁, R₁₁)."""
        q0 = np.arctan2(-rotation[:, 2, 1], rotation[:, 1, 1])
        upright = np.hypot(rotation[:, 2, 1], rotation[:, 1, 1])
        return self.at_q0(x, y, z, q0, np.arctan2(-rotation[:, 0, 1], upright))

    def _unturned(self, q: Array) -> tuple[Array, Array, Array]:
        r, h = self._section(q)
        return self._ax + r * np.cos(q[1]), self._ay + r * np.sin(q[1]), self._az + h

    def _section(self, q: Array) -> tuple[Array, Array]:
        link, tip = self.geometry.links
        psi = q[2] + q[3]
        return (
            link * np.sin(q[2]) + tip * np.sin(psi),
            self.geometry.rise + link * np.cos(q[2]) + tip * np.cos(psi),
        )

    def _bent(self, sides: tuple[tuple[Array, Array, Array, Array, Flags | bool], ...]) -> Branches:
        link, tip = self.geometry.links
        q = np.empty((4, 2 * len(sides), len(sides[0][0])))
        reached = np.empty(q.shape[1:], dtype=bool)
        for k, (r, height, q0, q1, real) in enumerate(sides):
            bend = two_link(r, height, link, tip)
            for row, sign in ((2 * k, 1.0), (2 * k + 1, -1.0)):
                q[0, row], q[1, row] = q0, q1
                q[2, row] = bend.towards - sign * bend.lead
                q[3, row] = sign * bend.elbow
                reached[row] = bend.reached & real
        return q, reached
