"""The index, middle and ring finger in closed form: abduction, then three joints that bend in one plane.

In the base frame, with φ = q₁ + q₂ + q₃ and links l₁, l₂, t (docs/kinematics.md#finger):
r = l₁ sin q₁ + l₂ sin(q₁ + q₂) + t sin φ, h = L₀ + l₁ cos q₁ + l₂ cos(q₁ + q₂) + t cos φ,
tip = (r cos q₀, r sin q₀, h), R = Rz(q₀) Ry(φ).
Joints are held as rows, shape (4, ...), rad; branches as (4, k, N).
"""

from __future__ import annotations

import numpy as np

from allegro_twin.kinematics.geometry import Geometry
from allegro_twin.kinematics.planar import TOUCH, Flags, two_link
from allegro_twin.types import Array

Branches = tuple[Array, Flags]
"""Joints (4, k, N), and which branches reach their target (k, N)."""


class ImaFinger:
    """Forward and inverse in the base frame. Targets come as coordinates x, y, z, each of shape (N,), m."""

    def __init__(self, geometry: Geometry) -> None:
        self.geometry = geometry
        self._height = float(geometry.offset[2])

    def tip(self, q: Array) -> tuple[Array, Array, Array]:
        """The fingertip, shape (4, ...) → three of (...)."""
        r, h = self.section(q)
        return r * np.cos(q[0]), r * np.sin(q[0]), h

    def section(self, q: Array) -> tuple[Array, Array]:
        """The fingertip in the plane in which the finger bends: r and h, each (...)."""
        first, second, tip = self.geometry.links
        a, b, c = q[1], q[1] + q[2], q[1] + q[2] + q[3]
        r = first * np.sin(a) + second * np.sin(b) + tip * np.sin(c)
        h = self._height + first * np.cos(a) + second * np.cos(b) + tip * np.cos(c)
        return r, h

    def rotation(self, q: Array) -> Array:
        """R = Rz(q₀) Ry(φ), shape (4, ...) → (..., 3, 3)."""
        return turn_then_bend(q[0], q[1] + q[2] + q[3])

    def turned_towards(self, q: Array, x: Array, y: Array, z: Array, lower: Array, upper: Array) -> Array:
        """The same bend with q₀, within its limits, turned to bring the tip nearest to a target."""
        r, _ = self.section(q)
        turned: Array = q.copy()
        turned[0] = clipped_angle(np.arctan2(y, x) + np.where(r < 0, np.pi, 0.0), lower[0], upper[0])
        return turned

    def at_pitch(self, x: Array, y: Array, z: Array, pitch: Array) -> Branches:
        """Both sides of the abduction axis times both elbows: four branches."""
        reach, q0 = np.hypot(x, y), np.arctan2(y, x)
        q0 = np.where(reach <= TOUCH, 0.0, q0)  # On the axis every q₀ does.
        return self._bent(((reach, q0, pitch), (-reach, q0 + np.pi, pitch)), z)

    def at_rotation(self, x: Array, y: Array, z: Array, rotation: Array) -> Branches:
        """Position exact; on either side of the abduction axis the pitch that comes nearest to R, shape (N, 3, 3)."""
        reach = np.hypot(x, y)
        on_axis = np.arctan2(-rotation[:, 0, 1], rotation[:, 1, 1])  # R says which q₀, where the position does not.
        q0 = np.where(reach <= TOUCH, on_axis, np.arctan2(y, x))
        sides = []
        for r, turn in ((reach, q0), (-reach, q0 + np.pi)):
            pitch = nearest_bend(rotation, np.cos(turn), np.sin(turn))
            sides.append((r, turn, self._attainable(pitch, r, z - self._height)))
        return self._bent(tuple(sides), z)

    def _bent(self, sides: tuple[tuple[Array, Array, Array], ...], z: Array) -> Branches:
        first, second, tip = self.geometry.links
        q = np.empty((4, 2 * len(sides), len(z)))
        reached = np.empty(q.shape[1:], dtype=bool)
        height = z - self._height
        for k, (r, q0, pitch) in enumerate(sides):
            bend = two_link(r - tip * np.sin(pitch), height - tip * np.cos(pitch), first, second)
            for row, sign in ((2 * k, 1.0), (2 * k + 1, -1.0)):
                q[0, row] = q0
                q[1, row] = bend.towards - sign * bend.lead
                q[2, row] = sign * bend.elbow
                q[3, row] = pitch - q[1, row] - q[2, row]
                reached[row] = bend.reached
        return q, reached

    def _attainable(self, pitch: Array, r: Array, h: Array) -> Array:
        """The pitch nearest to the one asked for at which the rest of the finger reaches (r, h), shape (N,).

        With (r, h) = D (sin α, cos α), d² = D² + t² - 2 t D cos(φ - α) must lie in [(l₁ - l₂)², (l₁ + l₂)²].
        """
        first, second, tip = self.geometry.links
        square, alpha = r * r + h * h, np.arctan2(r, h)
        scale = np.maximum(2 * tip * np.sqrt(square), 1e-300)
        least = np.arccos(np.clip((square + tip * tip - (first - second) ** 2) / scale, -1.0, 1.0))
        most = np.arccos(np.clip((square + tip * tip - (first + second) ** 2) / scale, -1.0, 1.0))
        away = wrapped(pitch - alpha)
        inside = np.clip(np.abs(away), least, most)
        return np.where(inside == np.abs(away), pitch, alpha + np.copysign(inside, away))


def nearest_bend(rotation: Array, cosine: Array, sine: Array) -> Array:
    """The φ for which Rz(q₀) Ry(φ) is nearest to R, shape (N,): φ = atan2(B₀₂ - B₂₀, B₀₀ + B₂₂), B = Rz(q₀)ᵀ R."""
    b00 = cosine * rotation[:, 0, 0] + sine * rotation[:, 1, 0]
    b02 = cosine * rotation[:, 0, 2] + sine * rotation[:, 1, 2]
    pitch: Array = np.arctan2(b02 - rotation[:, 2, 0], b00 + rotation[:, 2, 2])
    return pitch


def turn_then_bend(turn: Array, bend: Array) -> Array:
    """Rz(turn) Ry(bend), each of shape (...) → (..., 3, 3)."""
    turn, bend = np.broadcast_arrays(turn, bend)
    ct, st, cb, sb = np.cos(turn), np.sin(turn), np.cos(bend), np.sin(bend)
    matrix = np.zeros((*turn.shape, 3, 3))
    matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 0, 2] = ct * cb, -st, ct * sb
    matrix[..., 1, 0], matrix[..., 1, 1], matrix[..., 1, 2] = st * cb, ct, st * sb
    matrix[..., 2, 0], matrix[..., 2, 2] = -sb, cb
    return matrix


def wrapped(angle: Array, middle: Array | float = 0.0) -> Array:
    """The same angle within π of `middle`, rad."""
    turned: Array = angle - 2 * np.pi * np.rint((angle - middle) / (2 * np.pi))
    return turned


def clipped_angle(angle: Array, lower: float, upper: float) -> Array:
    """The angle in [lower, upper] that is nearest on the circle, rad."""
    clipped: Array = np.clip(wrapped(angle, (lower + upper) / 2), lower, upper)
    return clipped
