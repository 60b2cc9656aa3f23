"""A path whose end is moved while it is followed, as a person does who drags a slider."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from allegro_twin.control.trajectory import SetPoint
from allegro_twin.types import Array, Vector

_LEAST = 0.15  # s. A short way in less than that would ask for more than the motors have.
_PEAK = 15.0 / 8.0  # Peak over mean speed of the polynomial from rest to rest.
_POWERS = np.arange(6)
_ONCE, _TWICE = _POWERS[1:], _POWERS[2:] * _POWERS[1:-1]  # What differentiating brings down.


@dataclass(frozen=True, slots=True, eq=False)
class _Leg:
    """A polynomial of the fifth degree from one moment to another, s."""

    begin: float
    end: float
    powers: Array
    """Of the time since its begin, (6, n)."""

    def at(self, t: float) -> tuple[Vector, Vector, Vector]:
        """Position, speed and acceleration, (n,) each: rad, rad/s, rad/s²."""
        s = min(max(t, self.begin), self.end) - self.begin
        rows = s**_POWERS
        first, second = np.zeros(6), np.zeros(6)
        first[1:] = _ONCE * rows[:5]
        second[2:] = _TWICE * rows[:4]
        return rows @ self.powers, first @ self.powers, second @ self.powers


class Steering:
    """A `Path` that rests at a posture, (n,), rad, until it heads for another; position, speed and acceleration never
    jump, however often the goal does. One thread may head for goals while others follow."""

    def __init__(self, position: Vector) -> None:
        self.goal = position
        """Where it ends, (n,), rad."""
        self._leg = _Leg(0.0, 0.0, np.vstack([position, np.zeros((5, len(position)))]))

    def __call__(self, t: float) -> SetPoint:
        position, velocity, _ = self._leg.at(t)
        return SetPoint(position, velocity)

    def head_for(self, t: float, goal: Vector, speed: float) -> float:
        """From time `t` on, s, go to a posture, (n,), rad, where the joint that travels furthest peaks at about
        `speed`, rad/s. When it will be there, s."""
        position, velocity, acceleration = self._leg.at(t)
        seconds = max(_PEAK * float(np.abs(goal - position).max()) / speed, _LEAST)
        away, fast, strong = goal - position, velocity * seconds, acceleration * seconds**2
        powers = np.stack(
            [
                position,
                velocity,
                acceleration / 2.0,
                (20.0 * away - 12.0 * fast - 3.0 * strong) / (2.0 * seconds**3),
                (-30.0 * away + 16.0 * fast + 3.0 * strong) / (2.0 * seconds**4),
                (12.0 * away - 6.0 * fast - strong) / (2.0 * seconds**5),
            ]
        )
        self.goal, self._leg = goal, _Leg(t, t + seconds, powers)
        return t + seconds
