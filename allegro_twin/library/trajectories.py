"""Named trajectories: a motion that somebody has shown to a hand, to be played on either."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from allegro_twin.control.trajectory import Moves, Profile, Waypoint
from allegro_twin.types import Array, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A stored trajectory for one hand."""

    name: str
    times: Vector
    """Ascending, shape (k,), s."""
    positions: Array
    """Shape (k, n), rad."""

    def reference(self, speed: float = 1.0, profile: Profile = "minimum_jerk") -> Moves:
        """What a position controller follows: to the first position, with `speed` (rad/s) as its peak, then in
        straight lines from one position to the next, each at its time."""
        first = Waypoint(self.positions[0], speed=speed, profile=profile)
        legs = [
            Waypoint(position, seconds=float(after - before), profile="linear")
            for (before, after), position in zip(pairwise(self.times), self.positions[1:], strict=True)
        ]
        return Moves([first, *legs])

    @property
    def seconds(self) -> float:
        """How long the motion takes once the hand is at its first position."""
        return float(np.ptp(self.times))
