"""Whether a thing is in the hand: by its weight, and by what stops the fingers. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from allegro_twin.arm.tool import Bridge
from allegro_twin.lab.settings import ValidateSettings
from allegro_twin.types import Array, Vector

_GRAVITY = 9.81  # m/s².


@dataclass(frozen=True, slots=True)
class Checked:
    """What force and torques say."""

    weight: float
    """Of what hangs on the hand, kg."""
    torque: float
    """That stops the fingers, summed over the joints, N·m."""
    by_force: bool
    by_torque: bool
    held: bool
    """By the one of the two that decides."""


def checked(weight: float, torque: float, settings: ValidateSettings) -> Checked:
    """The verdict on both."""
    force, press = weight > settings.least, torque > settings.torque
    return Checked(weight, torque, force, press, force if settings.by == "force" else press)


def weighed(bridge: Bridge, before: Sequence[Vector], after: Sequence[Vector], axes: Array, gravity: Vector) -> float:
    """kg, from samples of the flange's sensor at rest, (6,) each, with the same orientation of the flange (3, 3).

    The mean of those before is the tare: only what came on between is weighed.
    """
    tared = bridge.tared([bridge.felt(wrench, axes, gravity) for wrench in before])
    return float(-tared.outside(np.mean(after, axis=0), axes, gravity, np.zeros(3))[2] / _GRAVITY)


def stopped(torque: Vector, gravity: Vector, friction: Vector) -> float:
    """What the motors give, (n,), beyond the fingers' own weight and twice their dry friction, summed, N·m."""
    return float(np.maximum(np.abs(torque - gravity) - 2.0 * friction, 0.0).sum())
