"""Where the joints should be, and when: what a position controller follows."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple, Protocol, TypeAlias

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.types import Vector, frozen

Profile: TypeAlias = Literal["linear", "minimum_jerk"]
# Peak over mean speed: 1 for a straight line, 15/8 for the minimum-jerk polynomial.
_PEAK: dict[str, float] = {"linear": 1.0, "minimum_jerk": 15.0 / 8.0}


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


@dataclass(frozen=True, slots=True, eq=False)
class Moves:
    """Go through waypoints one after the other, beginning wherever the hand is, and stay at the last."""

    waypoints: Sequence[Waypoint]

    def begin(self, position: Vector) -> Trajectory:
        """The timed trajectory. Raises ConfigError for a speed or a time that is not positive."""
        times, postures, profiles = [0.0], [frozen(position)], []
        for waypoint in self.waypoints:
            times.append(times[-1] + travel_time(postures[-1], waypoint))
            postures.append(frozen(waypoint.posture))
            profiles.append(waypoint.profile)
        return Trajectory(tuple(times), tuple(postures), tuple(profiles))


class Trajectory:
    """Joint positions through waypoints at given times (s, ascending)."""

    def __init__(self, times: tuple[float, ...], postures: tuple[Vector, ...], profiles: tuple[Profile, ...]) -> None:
        self.times, self.postures, self.profiles = times, postures, profiles
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
        s = (t - start) / seconds
        if self.profiles[leg] == "linear":
            part, rate = s, 1.0 / seconds
        else:
            part, rate = s**3 * (10.0 + s * (6.0 * s - 15.0)), 30.0 * s**2 * (1.0 - s) ** 2 / seconds
        travel = self._travel[leg]
        return SetPoint(self.postures[leg] + part * travel, rate * travel)


def travel_time(start: Vector, waypoint: Waypoint) -> float:
    """Seconds from a posture to a waypoint. Raises ConfigError unless speed and time are positive."""
    if waypoint.seconds is not None:
        if not waypoint.seconds > 0.0:
            raise ConfigError(f"a move must take a positive time, not {waypoint.seconds} s")
        return waypoint.seconds
    if not waypoint.speed > 0.0:
        raise ConfigError(f"speed must be positive, in rad/s; it is {waypoint.speed}")
    furthest = float(np.abs(waypoint.posture - start).max())
    return max(furthest * _PEAK[waypoint.profile] / waypoint.speed, 1e-3)
