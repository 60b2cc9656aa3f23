"""Orientations: unit quaternions, matrices, Euler angles and rotation vectors, and gravity in a turned frame.

A quaternion is (w, x, y, z); q and -q are one orientation. Euler angles are roll, pitch and yaw about the fixed axes x,
y and z, in that order, as in URDF: R = Rz(yaw) Ry(pitch) Rx(roll). A rotation vector is the axis times the angle. The
columns of a matrix are the turned frame's axes. Angles rad; every function works over leading axes, and a row's result
does not depend on how many there are (the products of linear algebra libraries do). NaN gives NaN, except of a
quaternion that has to be brought to length one. Raises ConfigError for other shapes. Functions take NumPy's arrays, and
what becomes one; those that take PyTorch's tensors, too, and return them, say so.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.array_api import array_namespace, as_array
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.arguments import numbers, rows
from allegro_twin.kinematics.maths import ARRAYS, Maths, T
from allegro_twin.types import Array

Entries = tuple[T, T, T, T, T, T, T, T, T]
"""A matrix row by row, of one orientation or of a batch of them."""

STANDARD_GRAVITY = 9.81  # m/s², as in every scene.
_NO_LENGTH = 1e-9  # A quaternion or a vector this short has no direction.


def matrix_from_euler(angles: ArrayLike) -> Array:
    """R = Rz(yaw) Ry(pitch) Rx(roll), shape (..., 3) → (..., 3, 3)."""
    return _matrix(entries_of_euler(ARRAYS, *_columns(angles, 3, "Euler angles", "roll, pitch, yaw")))


def euler_from_matrix(rotation: ArrayLike) -> Array:
    """Roll, pitch, yaw of R, shape (..., 3, 3) → (..., 3), pitch in [-π/2, π/2].

    Where pitch is ±π/2 only roll ∓ yaw is determined; what is returned still gives back R, because roll is taken from
    Rz(yaw)ᵀ R and not from R itself.
    """
    a, b, c, d, e, f, g, _, _ = entries_of_matrix(rotation)
    yaw, pitch = np.arctan2(d, a), np.arctan2(-g, np.hypot(a, d))
    s, k = np.sin(yaw), np.cos(yaw)
    return np.stack([np.arctan2(s * c - k * f, k * e - s * b), pitch, yaw], axis=-1)


def matrix_from_quaternion(quaternion: ArrayLike) -> Array:
    """The rotation of a quaternion of any length but zero, shape (..., 4) → (..., 3, 3)."""
    return _matrix(entries_of_quaternion(*_unit(quaternion)))


def quaternion_from_matrix(rotation: ArrayLike) -> Array:
    """The quaternion, w ≥ 0, of R, shape (..., 3, 3) → (..., 4).

    The largest column of 4 q qᵀ, a matrix that is linear in R, is q up to its length: accurate at every angle.
    """
    a, xy, xz, yx, b, yz, zx, zy, c = entries_of_matrix(rotation)
    x, y, z, xy, xz, yz = zy - yz, xz - zx, yx - xy, xy + yx, xz + zx, yz + zy
    rows = (
        (1 + a + b + c, x, y, z), (x, 1 + a - b - c, xy, xz), (y, xy, 1 - a + b - c, yz), (z, xz, yz, 1 - a - b + c)
    )  # fmt: skip
    outer = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    largest = np.argmax(np.einsum("...ii->...i", outer), axis=-1)
    column = np.take_along_axis(outer, largest[..., None, None], axis=-1)[..., 0]
    unit = column / _length(column)[..., None]
    return np.where(unit[..., :1] < 0, -unit, unit)


def quaternion_from_euler(angles: ArrayLike) -> Array:
    """The quaternion of Rz(yaw) Ry(pitch) Rx(roll), shape (..., 3) → (..., 4)."""
    halves = [angle / 2.0 for angle in _columns(angles, 3, "Euler angles", "roll, pitch, yaw")]
    (cr, cp, cy), (sr, sp, sy) = map(np.cos, halves), map(np.sin, halves)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return np.stack([w, x, y, z], axis=-1)


def quaternion_from_vector(turn: ArrayLike) -> Array:
    """The quaternion of a rotation vector, shape (..., 3), rad → (..., 4). Takes tensors, too."""
    vector = _given("rotation vectors", turn, 3)
    xp, size = array_namespace(vector), _length(vector)
    scale = xp.where(size > 1e-12, xp.sin(size / 2) / xp.maximum(size, 1e-12), 0.5)
    return as_array(xp.concatenate([xp.cos(size / 2)[..., None], scale[..., None] * vector], axis=-1))


def vector_from_quaternion(quaternion: ArrayLike) -> Array:
    """The shortest rotation vector of a quaternion, shape (..., 4) → (..., 3), rad, no longer than π."""
    w, x, y, z = _unit(quaternion)
    axis = np.stack([x, y, z], axis=-1) * np.where(w < 0, -1.0, 1.0)[..., None]
    size = _length(axis)
    scale = np.where(size > 1e-12, 2.0 * np.arctan2(size, np.abs(w)) / np.maximum(size, 1e-12), 2.0)
    return np.asarray(axis * scale[..., None])


def quaternion_product(first: ArrayLike, second: ArrayLike) -> Array:
    """The quaternion product, the turn `second` in the axes that `first` has turned, (..., 4). Takes tensors, too."""
    one, other = _given("quaternions", first, 4), _given("quaternions", second, 4)
    a, b, c, d = (one[..., k] for k in range(4))
    w, x, y, z = (other[..., k] for k in range(4))
    i, j, k = a * x + b * w + c * z - d * y, a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w
    return as_array(array_namespace(one).stack([a * w - b * x - c * y - d * z, i, j, k], axis=-1))


def quaternion_conjugate(quaternion: ArrayLike) -> Array:
    """The inverse rotation, (..., 4)."""
    return rows("quaternions", quaternion, 4) * (1.0, -1.0, -1.0, -1.0)


def rotate_quaternion(quaternion: ArrayLike, turn: ArrayLike) -> Array:
    """An orientation (..., 4) turned by a rotation vector (..., 3), rad, in the world's axes. Takes tensors, too."""
    return quaternion_product(quaternion_from_vector(turn), quaternion)


def rotate_vector(vector: ArrayLike, turn: ArrayLike) -> Array:
    """Vectors (..., 3) turned by rotation vectors (..., 3), rad."""
    turned = matrix_from_quaternion(quaternion_from_vector(turn)) @ rows("vectors", vector, 3)[..., None]
    return np.asarray(turned[..., 0])


def slerp(first: ArrayLike, second: ArrayLike, part: ArrayLike) -> Array:
    """The orientation `part` (...) of the shortest way from the first to the second, (..., 4), at constant speed."""
    p, q = np.stack(_unit(first), axis=-1), np.stack(_unit(second), axis=-1)
    way = vector_from_quaternion(quaternion_product(q, quaternion_conjugate(p)))
    return rotate_quaternion(p, numbers("part", part)[..., None] * way)


def angle_between(first: ArrayLike, second: ArrayLike) -> Array:
    """The angle of the rotation from one matrix (..., 3, 3) to another, shape (...), rad."""
    return rotation_angle(ARRAYS, entries_of_matrix(first), entries_of_matrix(second))


def angle_between_quaternions(first: ArrayLike, second: ArrayLike) -> Array:
    """The angle between quaternions (..., 4) of any length, rad: twice Kahan's angle of two vectors. Takes tensors,
    too."""
    one, other = _given("quaternions", first, 4), _given("quaternions", second, 4)
    p, q = one / _length(one)[..., None], other / _length(other)[..., None]
    apart, along, xp = _length(p - q), _length(p + q), array_namespace(one)
    return as_array(4.0 * xp.arctan2(xp.minimum(apart, along), xp.maximum(apart, along)))


def matrix_facing(x: ArrayLike, z: ArrayLike) -> Array:
    """The matrix whose x axis is along `x` and whose z axis is as near to `z` as it can be, (..., 3) → (..., 3, 3).

    Raises ConfigError where one is zero, and where they are parallel.
    """
    along, towards = rows("facing", x, 3), rows("fingers", z, 3)
    for name, vector in (("facing", along), ("fingers", towards)):
        if not (_length(vector) > 0.0).all():
            raise ConfigError(f"wrist: {name} {vector.tolist()} is zero; it is a direction, such as [0, 0, -1]")
    first = along / _length(along)[..., None]
    last = towards - first * np.add.reduce(first * towards, axis=-1)[..., None]
    if not (_length(last) > 1e-6).all():
        raise ConfigError(f"wrist: fingers {towards.tolist()} must not be parallel to facing {along.tolist()}")
    last = last / _length(last)[..., None]
    return np.stack([first, np.cross(last, first), last], axis=-1)


def quaternion_facing(x: ArrayLike, z: ArrayLike) -> Array:
    """The orientation of a palm that looks along `x` with its fingers towards `z`, world axes, (..., 3) → (..., 4)."""
    return quaternion_from_matrix(matrix_facing(x, z))


def gravity_from_quaternion(quaternion: ArrayLike, size: float = STANDARD_GRAVITY) -> Array:
    """Gravity in the palm, R(q)ᵀ (0, 0, -g), of the palm's orientation in the world, (..., 4) → (..., 3), m/s²."""
    rows = entries_of_quaternion(*_unit(quaternion))[6:]  # World z in the palm frame.
    return np.asarray(-size * np.stack(rows, axis=-1))


def quaternion_from_gravity(gravity: ArrayLike) -> Array:
    """An orientation of the palm in the world with this gravity, the least turned one, (..., 3) → (..., 4), m/s²."""
    down = rows("gravity", gravity, 3)
    x, y, z = np.moveaxis(-down / _length(down)[..., None], -1, 0)
    flat = np.hypot(x, y)
    great = np.sqrt((1.0 + np.abs(z)) / 2.0)  # Of cos(θ/2) and sin(θ/2) the greater; the other follows from sin θ.
    w, v = np.where(z < 0, flat / (2.0 * great), great), np.where(z < 0, great, flat / (2.0 * great))
    some = np.where(flat > 0, flat, 1.0)
    return np.stack([w, np.where(flat > 0, v * y / some, v), -v * x / some, 0.0 * z], axis=-1)


def entries_of_matrix(rotation: ArrayLike) -> Entries[Array]:
    """The entries of a matrix, shape (..., 3, 3) → nine of (...)."""
    r = rows("rotation matrices", rotation, 3, 3)
    a, b, c, d, e, f, g, h, i = np.moveaxis(r.reshape(*r.shape[:-2], 9), -1, 0)
    return a, b, c, d, e, f, g, h, i


def entries_of_quaternion(w: T, x: T, y: T, z: T) -> Entries[T]:
    """The matrix of a unit quaternion, row by row."""
    return (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip


def entries_of_euler(m: Maths[T], roll: T, pitch: T, yaw: T) -> Entries[T]:
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, cp, cy, sr, sp, sy = m.cos(roll), m.cos(pitch), m.cos(yaw), m.sin(roll), m.sin(pitch), m.sin(yaw)
    return (
        cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,
        sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,
        -sp, cp * sr, cp * cr,
    )  # fmt: skip


def is_rotation(m: Maths[T], turn: Entries[T]) -> bool:
    """Whether the columns are orthonormal, their squared lengths to 1.1e-5 and their products to 1e-6, as
    `numpy.allclose` has it, and right-handed; of a batch, all of them."""
    a, b, c, d, e, f, g, h, i = turn
    off = (abs(a * a + d * d + g * g - 1.0) > 1.1e-5) | (abs(b * b + e * e + h * h - 1.0) > 1.1e-5)
    off |= (abs(c * c + f * f + i * i - 1.0) > 1.1e-5) | (abs(a * b + d * e + g * h) > 1e-6)
    off |= (abs(a * c + d * f + g * i) > 1e-6) | (abs(b * c + e * f + h * i) > 1e-6)
    return not m.any(off | (a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0.0))


def rotation_angle(m: Maths[T], first: tuple[T, ...], second: tuple[T, ...]) -> T:
    """The angle of the rotation from one to the other, rad, accurate near 0 and near π.

    With E the relative rotation, |E - 1|² = 8 sin²(θ/2) and 1 + tr E = 4 cos²(θ/2).
    """
    a, b, c, d, e, f, g, h, i = first
    o, p, q, r, s, t, u, v, w = second
    apart = (
        (a - o) * (a - o) + (b - p) * (b - p) + (c - q) * (c - q)
        + (d - r) * (d - r) + (e - s) * (e - s) + (f - t) * (f - t)
        + (g - u) * (g - u) + (h - v) * (h - v) + (i - w) * (i - w)
    )  # fmt: skip
    along = 1.0 + a * o + b * p + c * q + d * r + e * s + f * t + g * u + h * v + i * w
    return 2.0 * m.atan2(m.root(apart / 8.0), m.root(along) / 2.0)


def _matrix(entries: Entries[Array]) -> Array:
    return np.stack([np.stack(entries[k : k + 3], axis=-1) for k in (0, 3, 6)], axis=-2)


def _length(vector: Array) -> Array:
    """The length of vectors (..., k), shape (...)."""
    return as_array(array_namespace(vector).sqrt((vector * vector).sum(axis=-1)))


def _unit(quaternion: ArrayLike) -> tuple[Array, ...]:
    """w, x, y, z at length one. Raises ConfigError for another shape, and for a quaternion of no length."""
    given = np.stack(_columns(quaternion, 4, "quaternions", "w, x, y, z"), axis=-1)
    size = _length(given)
    if not (size > _NO_LENGTH).all():
        raise ConfigError("a quaternion of length zero, or with a NaN, is no orientation")
    return tuple(np.moveaxis(given / size[..., None], -1, 0))


def _columns(values: ArrayLike, n: int, what: str, names: str) -> tuple[Array, ...]:
    given = numbers(what, values)
    if given.shape[-1:] != (n,):
        raise ConfigError(f"{what} need shape (..., {n}): {names}; they have {given.shape}")
    return tuple(np.moveaxis(given, -1, 0))


def _given(what: str, values: ArrayLike, n: int) -> Array:
    """A tensor as it is, anything else as NumPy's array, (..., n)."""
    if not hasattr(values, "device") or isinstance(values, np.ndarray):
        return rows(what, values, n)
    tensor = as_array(values)
    if tuple(tensor.shape[-1:]) != (n,):
        raise ConfigError(f"{what} needs shape (..., {n}); it has {tuple(tensor.shape)}")
    return tensor
