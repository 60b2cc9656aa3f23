"""References and trajectories of joint positions, for position controllers to follow."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allegro_twin.control.time_scaling import Profile, TimeScaling, leg_timing
from allegro_twin.errors import ConfigError
from allegro_twin.types import Array, Vector, frozen

FASTEST = 60.0
"""rad/s. No joint of a hand is so fast: who asks for more, or has a guard allow more, has mistaken the unit."""
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
    "SpeedCheck",
    "Trajectory",
    "Waypoint",
    "travel_time",
]


class SetPoint(NamedTuple):
    """Positions and velocities of the joints that a controller follows at one time."""

    position: Vector
    """Shape (n,), rad."""
    velocity: Vector
    """Shape (n,), rad/s."""


class Path(Protocol):
    """A motion in time; t is in s since the controller began."""

    def __call__(self, t: float) -> SetPoint: ...


class Reference(Protocol):
    """A goal that becomes a path once the joint position is known."""

    def begin(self, position: Vector) -> Path:
        """The path from a joint position, shape (n,), rad."""
        ...


SpeedCheck: TypeAlias = Callable[[Vector, str], None]
"""Raises ConfigError for peak speeds of joints, (n,), rad/s, that their guard would stop; what moves, for messages."""


@dataclass(frozen=True, slots=True, eq=False)
class Hold:
    """A posture, from the first moment on."""

    posture: Vector

    def begin(self, position: Vector) -> Path:
        point = SetPoint(frozen(self.posture), frozen(np.zeros_like(self.posture)))
        return lambda t: point


@dataclass(frozen=True, slots=True, eq=False)
class KnownPath:
    """A path that does not depend on where the hand is when it begins."""

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
    """Waypoints one after the other, from where the hand is; it stays at the last."""

    waypoints: Sequence[Waypoint]
    check: SpeedCheck | None = None
    """Looks at the motion before it begins."""

    def checked(self, check: SpeedCheck) -> Moves:
        """Copy whose motion `check` examines before it begins."""
        return replace(self, check=check)

    def begin(self, position: Vector) -> Trajectory:
        """The timed trajectory. Raises ConfigError for a speed or a time that is not positive, and as `check` does."""
        times, postures, shapes = [0.0], [frozen(position)], []
        for waypoint in self.waypoints:
            seconds, shape = _leg(postures[-1], waypoint)
            times.append(times[-1] + seconds)
            postures.append(frozen(waypoint.posture))
            shapes.append(shape)
        path = Trajectory(tuple(times), tuple(postures), tuple(shapes))
        if self.check is not None:
            self.check(path.peak, "the motion")
        return path


class Trajectory:
    """Joint positions through postures at given times (s, ascending), with a time scaling for each leg."""

    def __init__(self, times: tuple[float, ...], postures: tuple[Vector, ...], shapes: tuple[TimeScaling, ...]) -> None:
        self.times, self.postures, self.shapes = times, postures, shapes
        self._travel = [after - before for before, after in pairwise(postures)]
        self._rest = SetPoint(postures[-1], frozen(np.zeros_like(postures[-1])))

    @property
    def seconds(self) -> float:
        """When the last waypoint is reached."""
        return self.times[-1]

    @property
    def peak(self) -> Vector:
        """The greatest speed of each joint, (n,), rad/s."""
        fastest = np.zeros_like(self.postures[-1])
        for travel, shape, (begin, end) in zip(self._travel, self.shapes, pairwise(self.times), strict=True):
            fastest = np.maximum(fastest, np.abs(travel) * shape(0.5)[1] / (end - begin))  # All are symmetrical.
        return fastest

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


def number(value: float, what: str) -> float:
    """What was given as a number. Raises ConfigError for anything else."""
    try:
        if isinstance(value, str | bytes):
            raise TypeError
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise ConfigError(f"{what} is a number; not {value!r}") from None


def _leg(start: Vector, waypoint: Waypoint) -> tuple[float, TimeScaling]:
    number(waypoint.speed, "speed, in rad/s,")
    number(waypoint.acceleration, "acceleration, in rad/s²,")
    if not SLOWEST <= waypoint.speed <= FASTEST:
        raise ConfigError(
            f"speed must be positive, in rad/s, from {SLOWEST:g} to {FASTEST:g}; it is {waypoint.speed:g}"
        )
    if not waypoint.acceleration > 0.0:
        raise ConfigError(f"acceleration must be positive, in rad/s²; it is {waypoint.acceleration}")
    if waypoint.seconds is not None and not number(waypoint.seconds, "the time of a move, in s,") > 0.0:
        raise ConfigError(f"a move must take a positive time, not {waypoint.seconds} s")
    furthest = float(np.abs(waypoint.posture - start).max())
    seconds, shape = leg_timing(waypoint.profile, furthest, waypoint.speed, waypoint.acceleration)
    return (max(seconds, 1e-3) if waypoint.seconds is None else waypoint.seconds), shape


class TimedPath:
    """Joint positions through postures at given times: on straight lines, or with velocities on cubics,

    q(s) = h₀₀ a + h₁₀ T ȧ + h₀₁ b + h₁₁ T ḃ        s = (t - t_a) / T, Hermite's h
    """

    def __init__(self, times: Vector, postures: Array, velocities: Array | None = None) -> None:
        """`times`: ascending from 0, (k,), s; `postures` and `velocities`: (k, n), rad and rad/s."""
        self.times, self.postures, self.velocities = times, postures, velocities
        self._rest = SetPoint(frozen(postures[-1]), frozen(np.zeros_like(postures[-1])))

    @property
    def seconds(self) -> float:
        """When the last posture is reached."""
        return float(self.times[-1])

    @property
    def peak(self) -> Vector:
        """The greatest speed of each joint, (n,), rad/s."""
        spans = np.diff(self.times)[:, None]
        mean = np.diff(self.postures, axis=0) / spans
        if self.velocities is None:
            return np.asarray(np.abs(mean).max(axis=0))
        before, after = self.velocities[:-1], self.velocities[1:]
        square, slope = 3.0 * (before + after) - 6.0 * mean, 6.0 * mean - 4.0 * before - 2.0 * after
        with np.errstate(divide="ignore", invalid="ignore"):
            turns = np.clip(-slope / (2.0 * square), 0.0, 1.0)  # Where within a leg the speed is greatest or least.
        s = np.where(square == 0.0, 0.0, turns)
        between = before + s * (slope + s * square)
        return np.asarray(np.abs([before, between, after]).max(axis=(0, 1)))

    def __call__(self, t: float) -> SetPoint:
        if t >= self.times[-1]:
            return self._rest
        leg = max(int(np.searchsorted(self.times, t, side="right")) - 1, 0)
        begin, span = self.times[leg], self.times[leg + 1] - self.times[leg]
        a, b, s = self.postures[leg], self.postures[leg + 1], (t - begin) / span
        if self.velocities is None:
            return SetPoint(frozen(a + s * (b - a)), frozen((b - a) / span))
        va, vb = span * self.velocities[leg], span * self.velocities[leg + 1]
        at = (1 + 2 * s) * (1 - s) ** 2 * a + s * (1 - s) ** 2 * va + s**2 * (3 - 2 * s) * b + s**2 * (s - 1) * vb
        rate = 6 * s * (1 - s) * (b - a) + (1 - s) * (1 - 3 * s) * va + s * (3 * s - 2) * vb
        return SetPoint(frozen(at), frozen(rate / span))


class BatchedTrajectories:
    """Many trajectories of the same number of joints, evaluated together; to the bit as one by one."""

    def __init__(self, paths: Sequence[Trajectory]) -> None:
        self._paths = paths
        legs = max(len(path.postures) for path in paths)
        n = len(paths[0].postures[0])
        # The last leg of each, from its last posture, does not move; neither do those that pad it.
        self._from, self._travel = np.zeros((2, len(paths), legs, n))
        for row, path in enumerate(paths):
            self._from[row, : len(path.postures)] = path.postures
            self._travel[row, : len(path.postures) - 1] = np.diff(path.postures, axis=0)
        self._moves = np.any(self._travel, axis=2)

    def __call__(self, rows: NDArray[np.int64], t: float) -> SetPoint:
        """The set-points of some rows at a time, s: (rows, n) each, rad and rad/s."""
        legs = np.empty(len(rows), dtype=np.int64)
        part, rate = np.zeros((2, len(rows), 1))
        for place, row in enumerate(rows.tolist()):
            path = self._paths[row]
            legs[place] = leg = max(bisect_right(path.times, t) - 1, 0)
            if self._moves[row, leg]:
                start, seconds = path.times[leg], path.times[leg + 1] - path.times[leg]
                done, speed = path.shapes[leg]((t - start) / seconds)
                part[place], rate[place] = done, speed / seconds
        travel = self._travel[rows, legs]
        return SetPoint(self._from[rows, legs] + part * travel, rate * travel)
