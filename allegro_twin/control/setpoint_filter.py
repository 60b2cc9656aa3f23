"""Set-points whose goal changes while the hand follows them: limited in speed, or smooth to the acceleration."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from allegro_twin.control.trajectory import Path, SetPoint
from allegro_twin.types import Array, Vector, frozen


@dataclass(slots=True, eq=False)
class RateLimitedSetpoint:
    """A reference and its path: it moves towards `goal` at `speed` (rad/s) of the joint that is furthest from it, the
    others in proportion. `goal`, (n,), rad, may be replaced at any time and from any thread."""

    goal: Vector
    speed: float
    _at: SetPoint | None = field(default=None)
    _t: float = 0.0

    def begin(self, position: Vector) -> Path:
        """Begin at a joint position, (n,), rad."""
        self._at, self._t = SetPoint(frozen(position), frozen(np.zeros_like(position))), 0.0
        return self

    @property
    def position(self) -> Vector:
        """The newest set-point, (n,), rad."""
        assert self._at is not None, "begin comes first"
        return self._at.position

    def __call__(self, t: float) -> SetPoint:
        """The set-point at t, s since `begin`; for a time in the past the newest one."""
        assert self._at is not None, "begin comes first"
        passed = t - self._t
        if passed <= 0.0:
            return self._at
        goal, position = self.goal, self._at.position
        travel = goal - position
        furthest = float(np.abs(travel).max())
        part = 1.0 if furthest <= self.speed * passed else self.speed * passed / furthest
        step = part * travel
        self._t, self._at = t, SetPoint(frozen(position + step), frozen(step / passed))
        return self._at


_LEAST = 0.15  # s. A short way in less than that would ask for more than the motors have.
_PEAK = 15.0 / 8.0  # Peak over mean speed of the polynomial from rest to rest.
_STRONGEST = 10.0 / math.sqrt(3.0)  # Its peak acceleration, for a way of 1 in a time of 1.
_POWERS = np.arange(6)
_ONCE, _TWICE = _POWERS[1:], _POWERS[2:] * _POWERS[1:-1]  # Factors of the first and second derivative.


@dataclass(frozen=True, slots=True, eq=False)
class _Leg:
    """A polynomial of the fifth degree from one moment to another, s."""

    begin: float
    end: float
    powers: Array
    """Coefficients of powers of the time since `begin`, (6, n)."""

    def at(self, t: float) -> tuple[Vector, Vector, Vector]:
        """Position, speed and acceleration, (n,) each: rad, rad/s, rad/s²."""
        s = min(max(t, self.begin), self.end) - self.begin
        rows = s**_POWERS
        first, second = np.zeros(6), np.zeros(6)
        first[1:] = _ONCE * rows[:5]
        second[2:] = _TWICE * rows[:4]
        return rows @ self.powers, first @ self.powers, second @ self.powers


class SmoothSetpoint:
    """A path that rests at a posture, (n,), rad, until it heads for another; position, speed and acceleration are
    continuous, however often the goal changes. One thread may set goals while others follow."""

    def __init__(self, position: Vector) -> None:
        self.goal = position
        """Where it ends, (n,), rad."""
        self._leg = _Leg(0.0, 0.0, np.vstack([position, np.zeros((5, len(position)))]))

    def __call__(self, t: float) -> SetPoint:
        position, velocity, _ = self._leg.at(t)
        return SetPoint(position, velocity)

    def head_for(self, t: float, goal: Vector, speed: float, acceleration: float = math.inf) -> float:
        """Go to a posture, (n,), rad, from time `t` on, s; the joint that travels furthest peaks at about `speed`,
        rad/s, and from rest at no more than an `acceleration`, rad/s². Returns the time of arrival, s."""
        position, velocity, pushed = self._leg.at(t)
        far = float(np.abs(goal - position).max())
        seconds = max(_PEAK * far / speed, math.sqrt(_STRONGEST * far / acceleration), _LEAST)
        away, fast, strong = goal - position, velocity * seconds, pushed * seconds**2
        powers = np.stack(
            [
                position,
                velocity,
                pushed / 2.0,
                (20.0 * away - 12.0 * fast - 3.0 * strong) / (2.0 * seconds**3),
                (-30.0 * away + 16.0 * fast + 3.0 * strong) / (2.0 * seconds**4),
                (12.0 * away - 6.0 * fast - strong) / (2.0 * seconds**5),
            ]
        )
        self.goal, self._leg = goal, _Leg(t, t + seconds, powers)
        return t + seconds
