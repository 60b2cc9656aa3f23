"""Orientations as Euler angles, unit quaternions and matrices.

Euler angles are roll, pitch and yaw about the fixed axes x, y and z, in that order, as in URDF:
R = Rz(yaw) Ry(pitch) Rx(roll). Quaternions are (w, x, y, z). All angles rad; every function works over leading axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.types import Array


def matrix_from_euler(angles: ArrayLike) -> Array:
    """R = Rz(yaw) Ry(pitch) Rx(roll), shape (..., 3) → (..., 3, 3)."""
    rpy = np.asarray(angles, dtype=np.float64)
    if rpy.shape[-1:] != (3,):
        raise ConfigError(f"Euler angles need shape (..., 3): roll, pitch, yaw; they have {rpy.shape}")
    (cr, cp, cy), (sr, sp, sy) = np.moveaxis(np.cos(rpy), -1, 0), np.moveaxis(np.sin(rpy), -1, 0)
    return _stacked(
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )


def euler_from_matrix(rotation: Array) -> Array:
    """Roll, pitch, yaw of R, shape (..., 3, 3) → (..., 3), pitch in [-π/2, π/2].

    Where pitch is ±π/2 only roll ∓ yaw is determined; what is returned still gives back R, because roll is taken from
    Rz(yaw)ᵀ R and not from R itself.
    """
    r = rotation
    yaw = np.arctan2(r[..., 1, 0], r[..., 0, 0])
    pitch = np.arctan2(-r[..., 2, 0], np.hypot(r[..., 0, 0], r[..., 1, 0]))
    s, c = np.sin(yaw), np.cos(yaw)
    roll = np.arctan2(s * r[..., 0, 2] - c * r[..., 1, 2], c * r[..., 1, 1] - s * r[..., 0, 1])
    return np.stack([roll, pitch, yaw], axis=-1)


def matrix_from_quaternion(quaternion: ArrayLike) -> Array:
    """The rotation of a quaternion (w, x, y, z) of any length but zero, shape (..., 4) → (..., 3, 3)."""
    given = np.asarray(quaternion, dtype=np.float64)
    if given.shape[-1:] != (4,):
        raise ConfigError(f"quaternions need shape (..., 4): w, x, y, z; they have {given.shape}")
    length = np.linalg.norm(given, axis=-1, keepdims=True)
    if not (length > 1e-9).all():
        raise ConfigError("a quaternion of length zero is no orientation")
    w, x, y, z = np.moveaxis(given / length, -1, 0)
    return _stacked(
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def quaternion_from_matrix(rotation: Array) -> Array:
    """The quaternion (w, x, y, z), w ≥ 0, of R, shape (..., 3, 3) → (..., 4).

    The largest column of 4 q qᵀ, a matrix that is linear in R, is q up to its length: accurate at every angle.
    """
    r = np.asarray(rotation, dtype=np.float64)
    a, b, c = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    x, y, z = r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]
    xy, xz, yz = r[..., 0, 1] + r[..., 1, 0], r[..., 0, 2] + r[..., 2, 0], r[..., 1, 2] + r[..., 2, 1]
    outer = _stacked(
        (1 + a + b + c, x, y, z), (x, 1 + a - b - c, xy, xz), (y, xy, 1 - a + b - c, yz), (z, xz, yz, 1 - a - b + c)
    )
    largest = np.argmax(np.einsum("...ii->...i", outer), axis=-1)
    column = np.take_along_axis(outer, largest[..., None, None], axis=-1)[..., 0]
    unit: Array = column / np.linalg.norm(column, axis=-1, keepdims=True)
    return np.where(unit[..., :1] < 0, -unit, unit)


def angle_between(first: Array, second: Array) -> Array:
    """The angle of the rotation from one orientation to another, shape (...), rad, accurate near 0 and near π.

    With E the relative rotation, |E - 1|² = 8 sin²(θ/2) and 1 + tr E = 4 cos²(θ/2).
    """
    sine = np.sqrt(np.square(first - second).sum(axis=(-2, -1)) / 8.0)
    trace = (first * second).sum(axis=(-2, -1))
    angle: Array = 2.0 * np.arctan2(sine, np.sqrt(np.maximum(0.0, 1.0 + trace)) / 2.0)
    return angle


def _stacked(*rows: tuple[Array, ...]) -> Array:
    """A matrix from its entries, which are arrays of one shape (...)."""
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
