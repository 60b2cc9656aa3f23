"""Data types of states and commands: frozen, in SI units, with read-only arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allegro_twin.errors import CommandError

Array: TypeAlias = NDArray[np.float64]
"""Any shape, float64."""
Vector: TypeAlias = NDArray[np.float64]
"""One axis, float64."""


def frozen(values: ArrayLike) -> Vector:
    """A read-only float64 copy."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


NO_WRENCH = frozen(np.empty(0))
"""Wrench of a device without a force-torque sensor: shape (0,)."""


@dataclass(frozen=True, slots=True, eq=False)
class HandState:
    """The whole hand, or arm, at the end of one control period. What it does not report is NaN, never zero.

    The arrays are read-only; whoever builds a state hands over arrays of its own (`frozen` copies).
    """

    t: float
    """s since reset, on the backend's own clock; strictly increasing."""
    tick: int
    """Periods since reset; a jump of more than one means missed periods."""
    position: Vector
    """Joint positions, shape (n,), rad."""
    velocity: Vector
    """Joint speeds, shape (n,), rad/s."""
    torque: Vector
    """Torques applied over the period that just ended, shape (n,), N·m."""
    temperature: Vector
    """Motor temperatures, shape (n,), °C."""
    gravity: Vector
    """Gravity in the palm frame, shape (3,), m/s²: from the IMU, the scene or the config; NaN where none says. Of an
    arm: in its base's frame."""
    wrench: Vector = field(default_factory=lambda: NO_WRENCH)
    """Wrench on an arm's flange from its load and contacts, as the sensor measures it: force and torque in the flange's
    frame, shape (6,), N and N·m. Shape (0,) without a sensor."""


@dataclass(frozen=True, slots=True, eq=False, init=False)
class TorqueCommand:
    """Torques to apply until the next command; any row of numbers. Raises CommandError unless one axis and finite."""

    torque: Vector
    """Per actuator, shape (m,), N·m."""

    def __init__(self, torque: ArrayLike) -> None:
        object.__setattr__(self, "torque", _checked(torque, "torque"))


@dataclass(frozen=True, slots=True, eq=False, init=False)
class PositionCommand:
    """Positions to go to, for a hand whose firmware closes the loop. Which of its parts a hand takes, its spec says.

    Takes any rows of numbers. Raises CommandError unless all have one axis and are finite, and no effort or duration is
    negative.
    """

    position: Vector
    """Per actuator, shape (m,), rad."""
    effort: Vector | None = None
    """The most that each motor may give on the way, shape (m,), N·m, infinite where its limit is unknown; None: what
    the hand allows. Zero everywhere is limp, and every hand takes that."""
    duration: float | None = None
    """What the way may take, s; None: as fast as the hand goes."""

    def __init__(self, position: ArrayLike, effort: ArrayLike | None = None, duration: float | None = None) -> None:
        object.__setattr__(self, "position", _checked(position, "position"))
        most = None if effort is None else _checked(effort, "effort", infinite=True)
        object.__setattr__(self, "effort", most)
        object.__setattr__(self, "duration", duration)
        if most is not None and (most.shape != self.position.shape or (most < 0.0).any()):
            raise CommandError(f"effort needs a number from 0 for each of {len(self.position)} positions, not {most}")
        if self.duration is not None and not 0.0 <= self.duration < math.inf:
            raise CommandError(f"duration must be a number of seconds from 0, not {self.duration}")

    @property
    def limp(self) -> bool:
        """Whether it lets go of the joints."""
        return self.effort is not None and not self.effort.any()


Command: TypeAlias = TorqueCommand | PositionCommand


class Sample(NamedTuple):
    """One turn of the loop."""

    state: HandState
    command: Command
    """The one computed from this state, not the one that led to it."""


def _checked(values: ArrayLike, name: str, *, infinite: bool = False) -> Vector:
    try:
        given = np.asarray(values)
    except (TypeError, ValueError) as error:
        raise CommandError(f"{name} must be an array of numbers, not {values!r}") from error
    if given.dtype.kind not in "fiu":
        raise CommandError(f"{name} must be an array of numbers, not of {given.dtype}: {values!r}")
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        raise CommandError(f"{name} has masked values: {values!r}; fill them with numbers")
    array = frozen(given)
    if array.ndim != 1:
        raise CommandError(f"{name} must have one axis, one value per actuator; it has shape {array.shape}")
    sound = np.isfinite(array)
    if not sound.all() and not (infinite and (sound := sound | np.isposinf(array)).all()):
        bad = int(np.flatnonzero(~sound)[0])
        raise CommandError(f"{name}[{bad}] is {array[bad]}; every value must be finite")
    return array
