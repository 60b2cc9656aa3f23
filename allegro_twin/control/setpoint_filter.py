"""A set-point that is moved while the hand follows it, never faster than a speed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from allegro_twin.control.trajectory import Path, SetPoint
from allegro_twin.types import Vector, frozen


@dataclass(slots=True, eq=False)
class Pursuit:
    """A reference and its path: towards `goal` at `speed` (rad/s) for the joint that is furthest from it, the others
    in proportion. `goal`, (n,), rad, may be replaced at any time and from any thread."""

    goal: Vector
    speed: float
    _at: SetPoint | None = field(default=None)
    _t: float = 0.0

    def begin(self, position: Vector) -> Path:
        """From a joint position, (n,), rad."""
        self._at, self._t = SetPoint(frozen(position), frozen(np.zeros_like(position))), 0.0
        return self

    @property
    def position(self) -> Vector:
        """The newest set-point, (n,), rad."""
        assert self._at is not None, "begin comes first"
        return self._at.position

    def __call__(self, t: float) -> SetPoint:
        """The set-point at t, s since `begin`; what is asked for the past is as it is now."""
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
