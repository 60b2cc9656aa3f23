"""The index, middle and ring finger in closed form: abduction, then three joints that bend in one plane.

In the base frame at joint 1, with φ = q₁ + q₂ + q₃ and links l₁, l₂, t (docs/explanation/kinematics.md#finger):
r = l₁ sin q₁ + l₂ sin(q₁ + q₂) + t sin φ, h = l₁ cos q₁ + l₂ cos(q₁ + q₂) + t cos φ,
tip = (r cos q₀, r sin q₀, h), R = Rz(q₀) Ry(φ).
Forward, joints are rows, shape (4, ...), rad; back, every formula takes numbers or arrays (N,).
"""

from __future__ import annotations

import numpy as np

from allegro_twin.kinematics.closed_form.forms.two_links import TOUCH, Branch, bend, two_links_of
from allegro_twin.kinematics.closed_form.geometry import Geometry
from allegro_twin.kinematics.maths import Maths, T
from allegro_twin.kinematics.orientation import Entries, rotation_angle
from allegro_twin.types import Array, Vector


class FingerForms:
    """Forward and inverse in the base frame at joint 1. A target is x, y, z, m."""

    surely_nearest = np.inf
    """A branch inside the limits with at most this angle left, rad, is turned nearest of all postures there: any is."""

    def __init__(self, geometry: Geometry, lower: Vector, upper: Vector) -> None:
        self.links = geometry.links
        self.shift = geometry.offset
        """From the base's origin to where its targets are counted from, shape (3,), m."""
        self._pair = two_links_of(self.links[0], self.links[1])
        self._middle = float(lower[3] + upper[3]) / 2

    def tip(self, q: Array) -> tuple[Array, Array, Array]:
        """The fingertip, shape (4, ...) → three of (...)."""
        first, second, tip = self.links
        a, b, c = q[1], q[1] + q[2], q[1] + q[2] + q[3]
        r = first * np.sin(a) + second * np.sin(b) + tip * np.sin(c)
        h = first * np.cos(a) + second * np.cos(b) + tip * np.cos(c)
        return r * np.cos(q[0]), r * np.sin(q[0]), h

    def rotation(self, q: Array) -> Array:
        """R = Rz(q₀) Ry(φ), shape (4, ...) → (..., 3, 3)."""
        return turn_then_bend(q[0], q[1] + q[2] + q[3])

    def view(self, m: Maths[T], turn: Entries[T]) -> tuple[T, ...]:
        """An orientation as the methods below take it: row by row."""
        return turn

    def angle_to(self, m: Maths[T], q: Branch[T], view: tuple[T, ...]) -> T:
        """The angle of the rotation from the orientation of a posture to another, rad."""
        q0, q1, q2, q3 = q
        (c0, s0), (c, s) = m.circle(q0), m.circle(q1 + q2 + q3)
        return rotation_angle(m, (c0 * c, -s0, c0 * s, s0 * c, c0, s0 * s, -s, 0.0 * s, c), view)

    def at_pitch(self, m: Maths[T], x: T, y: T, z: T, pitch: T) -> list[Branch[T]]:
        """Both sides of the abduction axis times both elbows: four branches."""
        reach = m.root(x * x + y * y)
        turn = m.where(reach <= TOUCH, 0.0, m.atan2(y, x))  # On the axis every q₀ does.
        away = turn - m.copysign(reach * 0.0 + np.pi, turn)
        c, s = m.exact_circle(pitch)
        return self._bent(m, reach, z, turn, pitch, s, c) + self._bent(m, -reach, z, away, pitch, s, c)

    def at_rotation(self, m: Maths[T], x: T, y: T, z: T, view: tuple[T, ...]) -> tuple[list[Branch[T]], list[T]]:
        """Position exact; on either side of the abduction axis the pitch that turns nearest, and the angle left."""
        reach = m.root(x * x + y * y)
        on_axis = reach <= TOUCH  # R says which q₀, where the position does not.
        x, y = m.where(on_axis, view[4], x), m.where(on_axis, -view[1], y)
        length = m.root(x * x + y * y)
        length = m.where(length > 0.0, length, 1.0)
        cosine, sine, turn = x / length, y / length, m.atan2(y, x)
        away = turn - m.copysign(reach * 0.0 + np.pi, turn)
        found, left = [], []
        for r, q0, c0, s0 in ((reach, turn, cosine, sine), (-reach, away, -cosine, -sine)):
            s, c = self._nearest_pitch(m, r, z, c0, s0, view)
            found += self._bent(m, r, z, q0, m.atan2(s, c), s, c)
            angle = rotation_angle(m, (c0 * c, -s0, c0 * s, s0 * c, c0, s0 * s, -s, 0.0 * s, c), view)
            left += [angle, angle]
        return found, left

    def _nearest_pitch(self, m: Maths[T], r: T, h: T, c0: T, s0: T, view: tuple[T, ...]) -> tuple[T, T]:
        """sin φ and cos φ of the nearest rotation at which the rest of the finger reaches (r, h).

        φ = atan2(B₀₂ - B₂₀, B₀₀ + B₂₂), B = Rz(q₀)ᵀ R, is the nearest. With (r, h) = D (sin α, cos α),
        d² = D² + t² - 2 t D cos(φ - α) must lie in [(l₁ - l₂)², (l₁ + l₂)²], and so cos(φ - α) between two bounds.
        """
        tip = self.links[2]
        s, c = c0 * view[2] + s0 * view[5] - view[6], c0 * view[0] + s0 * view[3] + view[8]
        length = m.root(s * s + c * c)
        none = length <= 1e-12  # Half a turn off at every pitch.
        length = m.where(none, 1.0, length)
        s, c = m.where(none, 0.0, s) / length, m.where(none, 1.0, c) / length
        square = r * r + h * h
        distance = m.root(square)
        distance = m.where(distance > 1e-12, distance, 1e-12)
        least = (square + tip * tip - self._pair.outer) / (2 * tip * distance)
        most = (square + tip * tip - self._pair.inner) / (2 * tip * distance)
        along, across = (s * r + c * h) / distance, (s * h - c * r) / distance  # Of φ - α.
        brought = m.where(along < least, least, m.where(along > most, most, along))
        turn = m.copysign(m.root(1.0 - brought * brought), across)
        moved = (brought != along) & (abs(brought) <= 1.0)
        s = m.where(moved, (r * brought + h * turn) / distance, s)
        c = m.where(moved, (h * brought - r * turn) / distance, c)
        return s, c

    def _bent(self, m: Maths[T], r: T, h: T, turn: T, pitch: T, s: T, c: T) -> list[Branch[T]]:
        """Both elbows on one side, with sin φ and cos φ."""
        tip = self.links[2]
        a, b = r - tip * s, h - tip * c
        half, lead, hole = bend(m, a * a + b * b, self._pair)
        towards, elbow, turn = m.atan2(a, b), half + half, turn + hole
        first, second = towards - lead, towards + lead
        return [
            (turn, first, elbow, m.wrap(pitch - first - elbow, self._middle)),
            (turn, second, -elbow, m.wrap(pitch - second + elbow, self._middle)),
        ]


def turn_then_bend(turn: Array, bend: Array) -> Array:
    """Rz(turn) Ry(bend), each of shape (...) → (..., 3, 3)."""
    turn, bend = np.broadcast_arrays(turn, bend)
    ct, st, cb, sb = np.cos(turn), np.sin(turn), np.cos(bend), np.sin(bend)
    matrix = np.zeros((*turn.shape, 3, 3))
    matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 0, 2] = ct * cb, -st, ct * sb
    matrix[..., 1, 0], matrix[..., 1, 1], matrix[..., 1, 2] = st * cb, ct, st * sb
    matrix[..., 2, 0], matrix[..., 2, 2] = -sb, cb
    return matrix
