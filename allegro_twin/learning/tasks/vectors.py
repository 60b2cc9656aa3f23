"""Vector algebra on rows; a row's result does not depend on the number of rows (that of BLAS does)."""

from __future__ import annotations

import numpy as np

from allegro_twin.array_api import array_namespace, cross
from allegro_twin.types import Array


def length(v: Array) -> Array:
    """Length of vectors (..., k), shape (...)."""
    size: Array = array_namespace(v).sqrt((v * v).sum(axis=-1))
    return size


def effort_cost(action: Array) -> Array:
    """Cost of actions (..., n) in [-1, 1], as most rewards have it, shape (...)."""
    cost: Array = (action * action).sum(axis=-1) * (-0.02 / action.shape[-1])
    return cost


def rotate_vectors(quaternion: Array, vector: Array) -> Array:
    """Rotate vectors (..., 3) from a body's axes to the world's, with its orientation (..., 4)."""
    axis = quaternion[..., 1:]
    twice = 2.0 * cross(axis, vector)
    found: Array = vector + quaternion[..., :1] * twice + cross(axis, twice)
    return found


def tilt(quaternion: Array) -> Array:
    """Angle between a body's own z axis and the vertical, from its orientation (..., 4), shape (...), rad."""
    x, y, xp = quaternion[..., 1], quaternion[..., 2], array_namespace(quaternion)
    upward = 1.0 - 2.0 * (x * x + y * y)  # At most 1.
    angle: Array = xp.arccos(xp.maximum(upward, -1.0))
    return angle


def twist(quaternion: Array) -> Array:
    """Turn of bodies (..., 4) about the vertical, without their tilt, shape (...), rad in [-π, π]."""
    turn = 2.0 * array_namespace(quaternion).arctan2(quaternion[..., 3], quaternion[..., 0])
    angle: Array = (turn + np.pi) % (2.0 * np.pi) - np.pi
    return angle
