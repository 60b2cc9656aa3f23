"""From the palm to a finger's base frame, whichever hand it is: the left one is solved as the mirrored right one."""

from __future__ import annotations

import numpy as np

from allegro_twin.kinematics.closed_form.forms.maths import T
from allegro_twin.kinematics.closed_form.geometry import Geometry
from allegro_twin.kinematics.orientation import Entries
from allegro_twin.types import Array, Vector


class Frame:
    """The frame in which a chain counts its targets: the base's, moved by the chain's shift."""

    def __init__(self, geometry: Geometry, shift: Vector, *, left: bool) -> None:
        self._reflect = np.array([1.0, -1.0 if left else 1.0, 1.0])
        self._base, self._origin = geometry.base, geometry.base @ shift + geometry.origin
        self._left = left
        self._axes = tuple(map(float, geometry.base.T.ravel()))
        self._start = tuple(map(float, self._origin))

    def into(self, x: T, y: T, z: T) -> tuple[T, T, T]:
        """A place in the palm, m."""
        (a, b, c, d, e, f, g, h, i), (u, v, w) = self._axes, self._start
        x, y, z = x - u, (-y if self._left else y) - v, z - w
        return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z

    def turned_into(self, turn: Entries[T]) -> Entries[T]:
        """An orientation in the palm: Bᵀ S R S."""
        a, b, c, d, e, f, g, h, i = self._axes
        o, p, q, r, s, t, u, v, w = turn
        if self._left:
            p, r, t, v = -p, -r, -t, -v
        return (
            a * o + b * r + c * u, a * p + b * s + c * v, a * q + b * t + c * w,
            d * o + e * r + f * u, d * p + e * s + f * v, d * q + e * t + f * w,
            g * o + h * r + i * u, g * p + h * s + i * v, g * q + h * t + i * w,
        )  # fmt: skip

    def out(self, tip: tuple[Array, Array, Array]) -> Array:
        """A place in this frame, three of (...), in the palm, (..., 3), m."""
        return np.asarray((np.stack(tip, axis=-1) @ self._base.T + self._origin) * self._reflect)

    def turned_out(self, rotation: Array) -> Array:
        """An orientation in this frame, (..., 3, 3), in the palm."""
        return np.asarray((self._base @ rotation) * (self._reflect[:, None] * self._reflect))
