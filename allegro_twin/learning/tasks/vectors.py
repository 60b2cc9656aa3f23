"""Small vector algebra on rows; a row's result does not depend on how many there are (BLAS's products do)."""

from __future__ import annotations

import numpy as np

from allegro_twin.array_api import array_namespace, cross
from allegro_twin.types import Array


def length(v: Array) -> Array:
    """Of vectors (..., k), shape (...)."""
    size: Array = array_namespace(v).sqrt((v * v).sum(axis=-1))
    return size


def effort_of(action: Array) -> Array:
    """What moving costs in most rewards, actions (..., n) in [-1, 1], shape (...)."""
    cost: Array = (action * action).sum(axis=-1) * (-0.02 / action.shape[-1])
    return cost


def turned(quaternion: Array, vector: Array) -> Array:
    """Vectors (..., 3) of a body's axes in the world's, where its orientation is (..., 4)."""
    axis = quaternion[..., 1:]
    twice = 2.0 * cross(axis, vector)
    found: Array = vector + quaternion[..., :1] * twice + cross(axis, twice)
    return found


def tilt(quaternion: Array) -> Array:
    """Between a body's own z axis and the vertical, its orientation (..., 4), shape (...), rad."""
    x, y, xp = quaternion[..., 1], quaternion[..., 2], array_namespace(quaternion)
    upward = 1.0 - 2.0 * (x * x + y * y)  # At most 1.
    angle: Array = xp.arccos(xp.maximum(upward, -1.0))
    return angle


def twist(quaternion: Array) -> Array:
    """How far bodies (..., 4) are turned about the vertical, their tilt left out, shape (...), rad in [-π, π]."""
    turn = 2.0 * array_namespace(quaternion).arctan2(quaternion[..., 3], quaternion[..., 0])
    angle: Array = (turn + np.pi) % (2.0 * np.pi) - np.pi
    return angle
