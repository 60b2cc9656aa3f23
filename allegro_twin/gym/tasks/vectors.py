"""Small vector algebra on rows, written out so that a row's result does not depend on how many there are."""

from __future__ import annotations

import numpy as np

from allegro_twin.types import Array


def length(v: Array) -> Array:
    """Of vectors (..., 3), shape (...)."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    return np.sqrt(x * x + y * y + z * z)


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
    """Between two orientations, (..., 4) unit quaternions or nearly so, shape (...), rad."""
    between = product(p * (1.0, -1.0, -1.0, -1.0), q)
    return 2.0 * np.arctan2(length(between[..., 1:]), np.abs(between[..., 0]))


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
