"""Lengths and base frame of one finger, from models/<model>.yaml, where its axes have a closed form."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.kinematics.maths import T
from allegro_twin.kinematics.orientation import Entries, matrix_from_euler
from allegro_twin.types import Array, Vector, frozen

_FINGER = [[0, 0, 1], [0, 1, 0], [0, 1, 0], [0, 1, 0]]
_THUMB = [[-1, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 0]]


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """One finger of the right hand at zero. Lengths m; the base frame is joint 0's, seen from the palm."""

    is_thumb: bool
    origin: Vector
    """The base frame's origin in the palm, shape (3,)."""
    base: Array
    """The base frame's orientation in the palm, shape (3, 3)."""
    offset: Vector
    """From joint 0 to joint 1 in the base frame, shape (3,)."""
    rise: float
    """From joint 1 to joint 2 along z on the thumb; zero on a finger, whose joints 1 to 3 all bend."""
    links: tuple[float, ...]
    """From each bending joint to the next, and from the last to the tip: three on a finger, two on the thumb."""


@cache
def has_closed_form(model: str, finger: str) -> bool:
    """Whether `load_geometry` has it."""
    try:
        load_geometry(model, finger)
    except ConfigError:
        return False
    return True


@cache
def load_geometry(model: str, finger: str) -> Geometry:
    """The geometry of one finger, from models/<model>.yaml. Raises ConfigError where the closed form does not hold."""
    path = data_root() / "models" / f"{model}.yaml"
    if not path.is_file():
        raise ConfigError(f"{model} {finger}: no closed form, for its links and axes are in no models/{model}.yaml")
    table = read_yaml(path)
    place = table["fingers"][finger]
    rows = table["chains"][place["chain"]]
    axes = [row["axis"] for row in rows]
    steps = [row["xyz"] for row in rows[1:]] + [[0.0, 0.0, place["tip"]]]
    straight = all(step[:2] == [0, 0] for step in (steps if axes == _FINGER else steps[1:]))
    if axes not in (_FINGER, _THUMB) or not straight:
        raise ConfigError(f"{model} {finger}: its axes and offsets have no closed form")
    is_thumb = axes == _THUMB
    return Geometry(
        is_thumb=is_thumb,
        origin=frozen(place["xyz"]),
        base=frozen(matrix_from_euler(np.array(place["rpy"], dtype=np.float64))),
        offset=frozen(steps[0]),
        rise=float(steps[1][2]) if is_thumb else 0.0,
        links=tuple(float(step[2]) for step in steps[2 if is_thumb else 1 :]),
    )


class BaseFrame:
    """The base frame of a finger, moved by the shift of its forms, in the palm frame of its hand; a left hand is the
    mirror image of a right one."""

    def __init__(self, geometry: Geometry, shift: Vector, *, left: bool) -> None:
        self._reflect = np.array([1.0, -1.0 if left else 1.0, 1.0])
        self._base, self._origin = geometry.base, geometry.base @ shift + geometry.origin
        self._left = left
        self._axes = tuple(map(float, geometry.base.T.ravel()))
        self._start = tuple(map(float, self._origin))

    def from_palm(self, x: T, y: T, z: T) -> tuple[T, T, T]:
        """A point of the palm frame in this one, m."""
        (a, b, c, d, e, f, g, h, i), (u, v, w) = self._axes, self._start
        x, y, z = x - u, (-y if self._left else y) - v, z - w
        return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z

    def rotation_from_palm(self, turn: Entries[T]) -> Entries[T]:
        """An orientation in the palm frame, row by row, in this one: Bᵀ S R S."""
        a, b, c, d, e, f, g, h, i = self._axes
        o, p, q, r, s, t, u, v, w = turn
        if self._left:
            p, r, t, v = -p, -r, -t, -v
        return (
            a * o + b * r + c * u, a * p + b * s + c * v, a * q + b * t + c * w,
            d * o + e * r + f * u, d * p + e * s + f * v, d * q + e * t + f * w,
            g * o + h * r + i * u, g * p + h * s + i * v, g * q + h * t + i * w,
        )  # fmt: skip

    def to_palm(self, tip: tuple[Array, Array, Array]) -> Array:
        """A point of this frame, three of (...), in the palm frame, (..., 3), m."""
        return np.asarray((np.stack(tip, axis=-1) @ self._base.T + self._origin) * self._reflect)

    def rotation_to_palm(self, rotation: Array) -> Array:
        """An orientation in this frame, (..., 3, 3), in the palm frame."""
        return np.asarray((self._base @ rotation) * (self._reflect[:, None] * self._reflect))
