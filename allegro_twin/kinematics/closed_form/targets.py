"""Targets of inverse kinematics, read and checked: one on plain numbers, a batch in columns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import isfinite, prod
from typing import Generic, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.arguments import FURTHEST, numbers, rows, too_far
from allegro_twin.kinematics.maths import ARRAYS, FLOATS, Maths, T
from allegro_twin.kinematics.orientation import Entries, entries_of_euler, entries_of_quaternion, is_rotation
from allegro_twin.types import Array

_SHAPES: dict[str, tuple[int, ...]] = {"rotation": (3, 3), "quaternion": (4,), "euler": (3,), "near": (4,)}
_OF_FINGER = ("pitch", "rotation", "quaternion", "euler", "near")
_OF_THUMB = ("q0", "q1", "psi", "rotation", "quaternion", "euler", "near")

_LONGEST = 1e100
"""Longest quaternion whose square is a double, with room."""

Mode: TypeAlias = Literal["position", "pitch", "rotation", "q0", "q1", "psi"]
"""What a target fixes besides the position."""


class IkTarget(NamedTuple, Generic[T]):
    """Targets in the palm frame: one, or N which came in the shape (...)."""

    mode: Mode
    shape: tuple[int, ...]
    position: tuple[T, T, T]
    """m."""
    angle: T
    """The pitch, q0, q1 or psi asked for, rad; zero in the other modes."""
    rotation: Entries[T] | None
    near: tuple[T, ...] | None
    """rad."""


def read_target(
    finger: str, is_thumb: bool, position: ArrayLike, given: Mapping[str, ArrayLike | None]
) -> IkTarget[float] | IkTarget[Array]:
    """The targets of a call of `ik`, from its arguments. Raises ConfigError where they do not fit together."""
    points = _array(finger, "position", position, (3,))
    named = [(name, value) for name, value in given.items() if value is not None]
    known = _OF_THUMB if is_thumb else _OF_FINGER
    for name, _ in named:
        if name not in known:
            raise ConfigError(f"{finger} has no {name}: with a position it takes one of {', '.join(known)}")
    if len(named) > 1:
        raise ConfigError(
            f"{finger}: give one of {' and '.join(name for name, _ in named)}, not both; a position leaves one freedom"
        )
    shape = points.shape[:-1]
    if shape == ():
        return _target(FLOATS, _numbers, finger, shape, points, named)
    return _target(ARRAYS, _columns, finger, shape, points, named)


def _target(
    m: Maths[T],
    split: Callable[[str, str, Array, tuple[int, ...], tuple[int, ...]], list[T]],
    finger: str,
    shape: tuple[int, ...],
    points: Array,
    named: Sequence[tuple[str, ArrayLike]],
) -> IkTarget[T]:
    x, y, z = split(finger, "position", points, (3,), shape)
    if m.any((abs(x) > FURTHEST) | (abs(y) > FURTHEST) | (abs(z) > FURTHEST)):
        raise too_far(finger, points)
    if not named:
        return IkTarget("position", shape, (x, y, z), x * 0.0, None, None)
    ((name, value),) = named
    own = _SHAPES.get(name, ())
    values = split(finger, name, _array(finger, name, value, own), own, shape)
    if name == "near":
        return IkTarget("position", shape, (x, y, z), x * 0.0, None, tuple(values))
    if name in _SHAPES:
        return IkTarget("rotation", shape, (x, y, z), x * 0.0, _turn(m, finger, name, values), None)
    if name == "q1" and m.any(abs(m.cos(values[0])) < 1e-6):
        raise ConfigError(f"{finger}: at q1 = ±π/2 a position does not determine the other joints; give q0 or psi")
    return IkTarget(name, shape, (x, y, z), values[0], None, None)  # type: ignore[arg-type]  # One of the known.


def _turn(m: Maths[T], finger: str, name: str, values: list[T]) -> Entries[T]:
    if name == "euler":
        return entries_of_euler(m, *values)
    if name == "quaternion":
        w, x, y, z = values
        if m.any((abs(w) > _LONGEST) | (abs(x) > _LONGEST) | (abs(y) > _LONGEST) | (abs(z) > _LONGEST)):
            raise ConfigError(f"{finger}: a quaternion is w x y z of length 1; this one is longer than {_LONGEST:g}")
        length = m.root(w * w + x * x + y * y + z * z)
        if m.any(length <= 1e-9):
            raise ConfigError(f"{finger}: a quaternion of length zero is no orientation")
        return entries_of_quaternion(w / length, x / length, y / length, z / length)
    a, b, c, d, e, f, g, h, i = values
    turn = a, b, c, d, e, f, g, h, i
    if not is_rotation(m, turn):
        raise ConfigError(f"{finger}: rotation is no rotation matrix: its columns must be orthonormal, right-handed")
    return turn


def _array(finger: str, name: str, value: ArrayLike | None, own: tuple[int, ...]) -> Array:
    what = f"{finger}: {name}"
    return rows(what, value, *own) if own else numbers(what, value)


def _numbers(finger: str, name: str, array: Array, own: tuple[int, ...], shape: tuple[int, ...]) -> list[float]:
    """The numbers of one target."""
    if array.shape != own:
        raise _misfit(finger, name, array, shape)
    numbers: list[float] = array.ravel().tolist()
    if not all(map(isfinite, numbers)):
        raise _not_finite(finger, name, array)
    return numbers


def _columns(finger: str, name: str, array: Array, own: tuple[int, ...], shape: tuple[int, ...]) -> list[Array]:
    """The columns of N targets, (N,) each."""
    if not np.isfinite(array).all():
        raise _not_finite(finger, name, array)
    try:
        rows = np.broadcast_to(array, shape + own).reshape(prod(shape), prod(own))
    except ValueError as error:
        raise _misfit(finger, name, array, shape) from error
    return list(np.ascontiguousarray(rows.T))


def _misfit(finger: str, name: str, array: Array, shape: tuple[int, ...]) -> ConfigError:
    return ConfigError(f"{finger}: {name} {array.shape} does not go with positions {(*shape, 3)}")


def _not_finite(finger: str, name: str, array: Array) -> ConfigError:
    many = int((~np.isfinite(array)).sum())
    return ConfigError(f"{finger}: {name} must be finite; {many} of its values are not")
