"""Cartesian target of an arm's tool: a goal that may move, and the set-point that follows it at limited speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from allegro_twin.errors import CommandError
from allegro_twin.kinematics.arm import rotate, rotation_between
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import Array, Vector, frozen

_MS = 1e-3
_SHORT = 1e-12
_THERE = 1e-6  # m and rad. Less than an encoder shows.


@dataclass(frozen=True, slots=True)
class Smoothing:
    """Smoothing of a set-point on the path to its goal. The report's node bounds the step; libfranka's examples filter
    it."""

    speed: float = 0.25
    """At most, m/s."""
    turning: float = 1.0
    """At most, rad/s."""
    share: float = 0.005
    """Share of the remaining distance that the set-point moves in a millisecond: a time constant of 0.2 s. franka_ros,
    filter_params."""


SMOOTH = Smoothing()


class CartesianTarget:
    """A pose in the base's frame that rests until it is moved; one thread may move it while a controller follows.

    Raises CommandError for a pose that is none, and keeps the one that it has: the arm stays where it is.
    """

    def __init__(self, pose: Pose, wrench: Vector | None = None) -> None:
        self._pose, self._wrench = _checked(pose), _six(np.zeros(6) if wrench is None else wrench)

    @property
    def pose(self) -> Pose:
        return self._pose

    @property
    def wrench(self) -> Vector:
        """What the tool is to press with, force and torque in the axes of the base, (6,), N and N·m; for compliance."""
        return self._wrench

    def move(self, pose: Pose) -> None:
        """From now on, go there."""
        self._pose = _checked(pose)

    def press(self, wrench: Vector) -> None:
        """From now on, press with this."""
        self._wrench = _six(wrench)


def approach(now: Pose, goal: Pose, dt: float, smoothing: Smoothing | None) -> Pose:
    """The set-point `dt` seconds later: a straight line and the shortest turn (slerp), by the lesser of the filter's
    share and the bounded step. None: at once."""
    if smoothing is None or now is goal:
        return goal
    share = 1.0 - (1.0 - smoothing.share) ** (dt / _MS)
    way, left = goal.position - now.position, rotation_between(now.rotation, goal.rotation)
    far, wide = float(np.sqrt(way @ way)), float(np.sqrt(left @ left))
    if far < _THERE and wide < _THERE:
        return goal
    part = min(share, smoothing.speed * dt / max(far, _SHORT))
    twist = min(share, smoothing.turning * dt / max(wide, _SHORT))
    return Pose(now.position + part * way, rotate(now.rotation, twist * left))


def _checked(pose: Pose) -> Pose:
    position, rotation = np.asarray(pose.position, dtype=np.float64), np.asarray(pose.rotation, dtype=np.float64)
    if position.shape != (3,) or rotation.shape != (3, 3):
        raise CommandError(f"a target needs a position (3,) and axes (3, 3), not {position.shape} and {rotation.shape}")
    for name, values in (("position", position), ("rotation", rotation.ravel())):
        if not np.isfinite(values).all():
            bad = int(np.flatnonzero(~np.isfinite(values))[0])
            raise CommandError(
                f"target {name}[{bad}] is {values[bad]}; the arm keeps its last target: give a whole pose"
            )
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0.0:
        raise CommandError(
            "target rotation is no rotation matrix; the arm keeps its last target: give right-handed axes"
        )
    return Pose(frozen(position), _matrix(rotation))


def _matrix(rotation: Array) -> Array:
    copy = rotation.copy()
    copy.setflags(write=False)
    return copy


def _six(wrench: Vector) -> Vector:
    if np.shape(wrench) != (6,) or not np.isfinite(wrench).all():
        raise CommandError(f"a wrench is six finite numbers, force and torque, not {np.asarray(wrench).tolist()}")
    return frozen(wrench)
