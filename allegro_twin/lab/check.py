"""Whether a thing is in the hand: by its weight, by what stops the fingers, and by where they are. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from allegro_twin.lab.nothing import Nothing
from allegro_twin.lab.settings import ValidateSettings
from allegro_twin.types import Array, Vector

_GRAVITY = 9.81  # m/s².


@dataclass(frozen=True, slots=True)
class Checked:
    """What force, torques and joints say."""

    weight: float
    """Of what hangs on the hand, kg."""
    torque: float
    """That stops the fingers, summed over the joints, N·m."""
    between: float
    """Beyond what stops them around nothing, by where the fingers are, summed over the joints, N·m."""
    by_force: bool
    by_torque: bool
    by_fingers: bool
    held: bool
    """By the one of the three that decides."""
    doubt: str = ""
    """Why the force sensor is not to be trusted; nothing where it is."""


def checked(weight: float, torque: float, between: float, settings: ValidateSettings) -> Checked:
    """The verdicts of all three."""
    force, press, there = weight > settings.least, torque > settings.torque, between > settings.torque
    held = {"force": force, "torque": press, "fingers": there}[settings.by]
    return Checked(weight, torque, between, force, press, there, held)


def weighed(before: Sequence[Vector], after: Sequence[Vector], axes: Array) -> float:
    """kg, from what the flange felt of the world (`Bridge.felt`) at rest, (6,) each; `axes` are the flange's, (3, 3).

    The mean of those before is the tare: only what came on between is weighed.
    """
    return float(-(axes @ came_on(before, after))[2] / _GRAVITY)


def came_on(before: Sequence[Vector], after: Sequence[Vector]) -> Vector:
    """The force that is felt after and was not before, in the flange's axes, (3,), N."""
    return np.asarray((np.mean(after, axis=0) - np.mean(before, axis=0))[:3])


def stopped(torque: Vector, gravity: Vector, friction: Vector) -> float:
    """What the motors give, (n,), beyond the fingers' own weight and twice their dry friction, summed, N·m."""
    return float(np.maximum(np.abs(torque - gravity) - 2.0 * friction, 0.0).sum())


def kept_apart(
    position: Vector, nothing: Nothing, stiffness: Vector, friction: Vector, meeting: NDArray[np.bool_]
) -> float:
    """What keeps the telling fingers from where they would be around nothing, beyond twice their dry friction, summed,
    N·m. `position`, (n,), rad; `stiffness` is their controller's, (n,), N·m/rad; `friction`, (n,), N·m. Fingers that
    are `meeting` each other, (n,), do not tell; where no other is left, all that would."""
    off = stiffness * np.abs(position - nothing.position) - 2.0 * friction
    alone = nothing.telling & ~meeting
    return float(np.maximum(off, 0.0)[alone if alone.any() else nothing.telling].sum())
