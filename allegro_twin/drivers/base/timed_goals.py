"""A way that takes a given time, as a row of goals: servos have no say in how long they take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from allegro_twin.types import PositionCommand, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Glide:
    """Straight from one position to another, at one speed."""

    origin: Vector
    """Where it begins, shape (m,), rad."""
    end: Vector
    begin: float
    """s on the hand's clock."""
    duration: float
    """s; 0: at once."""

    def at(self, t: float) -> Vector:
        """The goal at that time, shape (m,), rad."""
        if t >= self.begin + self.duration:
            return self.end
        return self.origin + (self.end - self.origin) * max(t - self.begin, 0.0) / self.duration


def onward(before: Glide | None, position: Vector, command: PositionCommand, now: float) -> Glide:
    """The way of a command, from where the last one has led to, or from a position; the same command said again goes on
    with the way that it began."""
    duration = command.duration or 0.0
    if before is None:
        return Glide(position, command.position, now, duration)
    if before.duration == duration and np.array_equal(before.end, command.position):
        return before
    return Glide(before.at(now), command.position, now, duration)
