"""Small vector algebra on rows; a row's result does not depend on how many there are (BLAS's products do)."""

from __future__ import annotations

import numpy as np

from allegro_twin.types import Array


def length(v: Array) -> Array:
    """Of vectors (..., k), shape (...)."""
    size: Array = np.sqrt(np.add.reduce(v * v, axis=-1))
    return size


def effort_of(action: Array) -> Array:
    """What moving costs in most rewards, actions (..., n) in [-1, 1], shape (...)."""
    cost: Array = np.add.reduce(action * action, axis=-1) * (-0.02 / action.shape[-1])
    return cost


def turned(quaternion: Array, vector: Array) -> Array:
    """Vectors (..., 3) of a body's axes in the world's, where its orientation is (..., 4)."""
    axis = quaternion[..., 1:]
    twice = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + quaternion[..., :1] * twice + np.cross(axis, twice))


def tilt(quaternion: Array) -> Array:
    """Between a body's own z axis and the vertical, its orientation (..., 4), shape (...), rad."""
    x, y = quaternion[..., 1], quaternion[..., 2]
    return np.asarray(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0)))


def twist(quaternion: Array) -> Array:
    """How far bodies (..., 4) are turned about the vertical, their tilt left out, shape (...), rad in [-π, π]."""
    turn = 2.0 * np.arctan2(quaternion[..., 3], quaternion[..., 0])
    return np.asarray((turn + np.pi) % (2.0 * np.pi) - np.pi)
