"""JointTrajectory messages: times and postures of a hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.recording.messages import message_types as v
from allegro_twin.recording.messages.build import joint_order, joint_values
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

TRAJECTORY = "allegro_hand_trajectory_controller/joint_trajectory"
"""The topic, as joint_trajectory_controller of ros2_controllers names it under a controller."""
LATE, SOON = 0.5, 60.0
"""s. A trajectory whose beginning is further in the past, or in the future, is refused: clocks differ."""
_WHAT = "joint_trajectory"


class JointPath(NamedTuple):
    """The postures of a trajectory, and their times."""

    times: Vector
    """(k,), s from its beginning."""
    postures: Array
    """(k, n), rad, in the hand's order."""
    velocities: Array | None
    """(k, n), rad/s."""
    late: float
    """s until it begins."""


def joint_path(message: Any, spec: HandSpec, clock: Callable[[], int]) -> JointPath:
    """The postures of a message with points; `clock`: ns since 1970. Raises ConfigError for a message that this hand
    cannot follow."""
    points = message.points
    order = joint_order(spec, message.joint_names or ["(none)"], _WHAT)
    late = _wait(v.nanoseconds(message.header.stamp), clock)
    times = np.array([v.nanoseconds(point.time_from_start) / 1e9 for point in points])
    postures = np.array([joint_values(spec, point.positions, order, f"{_WHAT} positions") for point in points])
    with_speed = [len(point.velocities) > 0 for point in points]
    rates = None
    if all(with_speed):
        rates = np.array([joint_values(spec, point.velocities, order, f"{_WHAT} velocities") for point in points])
    elif any(with_speed):
        raise ConfigError(f"{_WHAT}: either all of its points have velocities, or none")
    return JointPath(times, postures, rates, late)


def _wait(stamp: int, clock: Callable[[], int]) -> float:
    """s until a trajectory begins; a stamp of zero is now."""
    late = (stamp - clock()) / 1e9 if stamp else 0.0
    if not -LATE <= late <= SOON:
        when = f"{abs(late):.1f} s {'ago' if late < 0 else 'from now'}"
        raise ConfigError(f"{_WHAT}: it begins {when} by its stamp; set the clocks, or leave the stamp 0")
    return max(late, 0.0) if math.isfinite(late) else 0.0
