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


def product(p: Array, q: Array) -> Array:
    """The quaternion product p q, (..., 4), w first."""
    a, b, c, d = (p[..., k] for k in range(4))
    w, x, y, z = (q[..., k] for k in range(4))
    return np.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        axis=-1,
    )


def angle(p: Array, q: Array) -> Array:
    """Between two orientations, (..., 4) quaternions of any length, shape (...), rad.

    Kahan's formula for the angle of two vectors, of which the turn is twice; q and -q are one orientation.
    """
    p, q = p / length(p)[..., None], q / length(q)[..., None]
    apart, along = length(p - q), length(p + q)
    turn: Array = 4.0 * np.arctan2(np.minimum(apart, along), np.maximum(apart, along))
    return turn


def turned_by(q: Array, turn: Array) -> Array:
    """An orientation (..., 4) turned by a rotation vector (..., 3), rad, in the axes of the world."""
    size = length(turn)
    scale = np.where(size > 1e-12, np.sin(size / 2) / np.maximum(size, 1e-12), 0.5)
    return product(np.concatenate([np.cos(size / 2)[..., None], scale[..., None] * turn], axis=-1), q)


def turn_about_z(before: Array, after: Array) -> Array:
    """How far an orientation has turned about the world's z, (...), rad: the twist of after · before⁻¹ about z."""
    change = product(after, before * (1.0, -1.0, -1.0, -1.0))
    turn = 2.0 * np.arctan2(change[..., 3], change[..., 0])
    return (turn + np.pi) % (2.0 * np.pi) - np.pi
