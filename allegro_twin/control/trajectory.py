"""Where the joints should be, and when: what a position controller follows."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np

from allegro_twin.control.time_scaling import Profile, Shape, timed
from allegro_twin.errors import ConfigError
from allegro_twin.types import Vector, frozen

FASTEST = 12.0
"""rad/s. The guard stops a hand that is faster (docs/explanation/safety.md), so nobody asks for more."""
SLOWEST = 1e-3
"""rad/s. Half an hour for a joint's whole range: who asks for less has mistaken the unit."""

__all__ = [
    "FASTEST",
    "SLOWEST",
    "Hold",
    "Moves",
    "Path",
    "Profile",
    "Reference",
    "SetPoint",
    "Trajectory",
    "Waypoint",
    "travel_time",
]


class SetPoint(NamedTuple):
    position: Vector
    """Shape (n,), rad."""
    velocity: Vector
    """Shape (n,), rad/s."""


class Path(Protocol):
    """A motion in time; t is in s since the controller began."""

    def __call__(self, t: float) -> SetPoint: ...


class Reference(Protocol):
    """A wish that becomes a path once it is known where the hand is."""

    def begin(self, position: Vector) -> Path:
        """The path from a joint position, shape (n,), rad."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Hold:
    """Be at a posture, at once."""

    posture: Vector

    def begin(self, position: Vector) -> Path:
        point = SetPoint(frozen(self.posture), frozen(np.zeros_like(self.posture)))
        return lambda t: point


@dataclass(frozen=True, slots=True, eq=False)
class Following:
    """Follow a path that is already known, from its beginning, wherever the hand is."""

    path: Path

    def begin(self, position: Vector) -> Path:
        return self.path


@dataclass(frozen=True, slots=True, eq=False)
class Waypoint:
    """A posture to reach, and how: by a time, or at a speed."""

    posture: Vector
    """Shape (n,), rad."""
    seconds: float | None = None
    """How long to take; None: as long as `speed` says."""
    speed: float = 1.0
    """rad/s, at its peak, of the joint that travels furthest. All joints arrive together."""
    profile: Profile = "minimum_jerk"
    acceleration: float = 20.0
    """rad/s², at most, of the joint that travels furthest, where the profile is `time_optimal`. A time in `seconds`
    stretches or squeezes that motion, and speed and acceleration with it."""


@dataclass(frozen=True, slots=True, eq=False)
class Moves:
    """Go through waypoints one after the other, beginning wherever the hand is, and stay at the last."""

    waypoints: Sequence[Waypoint]

    def begin(self, position: Vector) -> Trajectory:
        """The timed trajectory. Raises ConfigError for a speed or a time that is not positive."""
        times, postures, shapes = [0.0], [frozen(position)], []
        for waypoint in self.waypoints:
            seconds, shape = _leg(postures[-1], waypoint)
            times.append(times[-1] + seconds)
            postures.append(frozen(waypoint.posture))
            shapes.append(shape)
        return Trajectory(tuple(times), tuple(postures), tuple(shapes))


class Trajectory:
    """Joint positions through waypoints at given times (s, ascending), each leg in its shape."""

    def __init__(self, times: tuple[float, ...], postures: tuple[Vector, ...], shapes: tuple[Shape, ...]) -> None:
        self.times, self.postures, self.shapes = times, postures, shapes
        self._travel = [after - before for before, after in pairwise(postures)]
        self._rest = SetPoint(postures[-1], frozen(np.zeros_like(postures[-1])))

    @property
    def seconds(self) -> float:
        """When the last waypoint is reached."""
        return self.times[-1]

    def __call__(self, t: float) -> SetPoint:
        if t >= self.times[-1]:
            return self._rest
        leg = max(bisect_right(self.times, t) - 1, 0)
        start, seconds = self.times[leg], self.times[leg + 1] - self.times[leg]
        part, rate = self.shapes[leg]((t - start) / seconds)
        travel = self._travel[leg]
        return SetPoint(self.postures[leg] + part * travel, rate / seconds * travel)


def travel_time(start: Vector, waypoint: Waypoint) -> float:
    """Seconds from a posture to a waypoint. Raises ConfigError unless acceleration and time are positive, and the speed
    one that a hand can have."""
    return _leg(start, waypoint)[0]


def _leg(start: Vector, waypoint: Waypoint) -> tuple[float, Shape]:
    if not SLOWEST <= waypoint.speed <= FASTEST:
        raise ConfigError(
            f"speed must be positive, in rad/s, from {SLOWEST:g} to {FASTEST:g}, where the guard stops; it is "
            f"{waypoint.speed:g}"
        )
    if not waypoint.acceleration > 0.0:
        raise ConfigError(f"acceleration must be positive, in rad/s²; it is {waypoint.acceleration}")
    if waypoint.seconds is not None and not waypoint.seconds > 0.0:
        raise ConfigError(f"a move must take a positive time, not {waypoint.seconds} s")
    furthest = float(np.abs(waypoint.posture - start).max())
    seconds, shape = timed(waypoint.profile, furthest, waypoint.speed, waypoint.acceleration)
    return (max(seconds, 1e-3) if waypoint.seconds is None else waypoint.seconds), shape
