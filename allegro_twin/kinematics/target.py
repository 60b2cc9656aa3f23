"""What is asked of inverse kinematics, checked and laid out in rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.euler import matrix_from_euler, matrix_from_quaternion
from allegro_twin.kinematics.nearest import Mode
from allegro_twin.types import Array

_ORIENTATIONS = ("rotation", "quaternion", "euler")
_OF_FINGER = ("pitch", *_ORIENTATIONS, "near")
_OF_THUMB = ("q0", "q1", "psi", *_ORIENTATIONS, "near")


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """N targets in the palm frame, which came in the shape (...)."""

    mode: Mode
    shape: tuple[int, ...]
    position: Array
    """Shape (N, 3), m."""
    angle: Array
    """The pitch, q0, q1 or psi asked for, shape (N,), rad; zero in the other modes."""
    rotation: Array
    """Shape (N, 3, 3); empty in the other modes."""
    near: Array | None
    """Shape (N, 4), rad."""

    @property
    def n(self) -> int:
        return len(self.position)

    def rows(self, start: int, end: int) -> Target:
        """A block of the targets."""
        return replace(
            self,
            position=self.position[start:end],
            angle=self.angle[start:end],
            rotation=self.rotation[start:end],
            near=None if self.near is None else self.near[start:end],
        )


def read_target(finger: str, is_thumb: bool, position: ArrayLike, given: Mapping[str, ArrayLike | None]) -> Target:
    """The target that the arguments of `ik` describe. Raises ConfigError where they do not fit together."""
    points = _numbers(finger, "position", position, (3,))
    named = {name: value for name, value in given.items() if value is not None}
    known = _OF_THUMB if is_thumb else _OF_FINGER
    for name in named:
        if name not in known:
            raise ConfigError(f"{finger} has no {name}: with a position it takes one of {', '.join(known)}")
    if len(named) > 1:
        raise ConfigError(f"{finger}: give one of {' and '.join(named)}, not both; a position leaves one freedom")
    shape, n = points.shape[:-1], points[..., 0].size
    mode: Mode = "position"
    angle, rotation, near = np.zeros(n), np.zeros((n, 0)), None
    for name, value in named.items():
        if name == "near":
            near = _rows(finger, name, value, (4,), shape)
        elif name in _ORIENTATIONS:
            mode, rotation = "rotation", _rows(finger, "rotation", _matrix(finger, name, value), (3, 3), shape)
        else:
            mode, angle = name, _rows(finger, name, value, (), shape)  # type: ignore[assignment]  # One of the known.
    if mode == "q1" and (np.abs(np.cos(angle)) < 1e-6).any():
        raise ConfigError(f"{finger}: at q1 = ±π/2 a position does not determine the other joints; give q0 or psi")
    return Target(mode, shape, np.ascontiguousarray(points.reshape(-1, 3)), angle, rotation, near)


def _matrix(finger: str, name: str, value: ArrayLike) -> Array:
    if name == "quaternion":
        return matrix_from_quaternion(value)
    if name == "euler":
        return matrix_from_euler(value)
    matrix = _numbers(finger, name, value, (3, 3))
    if not np.allclose(np.swapaxes(matrix, -1, -2) @ matrix, np.eye(3), atol=1e-6) or (np.linalg.det(matrix) < 0).any():
        raise ConfigError(f"{finger}: rotation is no rotation matrix: its columns must be orthonormal, right-handed")
    return matrix


def _rows(finger: str, name: str, value: ArrayLike, own: tuple[int, ...], shape: tuple[int, ...]) -> Array:
    array = _numbers(finger, name, value, own)
    try:
        return np.broadcast_to(array, shape + own).reshape(-1, *own)
    except ValueError as error:
        raise ConfigError(f"{finger}: {name} {array.shape} does not go with positions {(*shape, 3)}") from error


def _numbers(finger: str, name: str, value: ArrayLike, own: tuple[int, ...]) -> Array:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{finger}: {name} must be numbers, not {value!r}") from error
    if own and array.shape[-len(own) :] != own:
        raise ConfigError(f"{finger}: {name} needs shape (..., {', '.join(map(str, own))}); it has {array.shape}")
    if not np.isfinite(array).all():
        raise ConfigError(f"{finger}: {name} must be finite; {int((~np.isfinite(array)).sum())} of its values are not")
    return array
