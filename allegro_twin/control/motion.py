"""A motion that somebody has shown to a hand, to be repeated as it was, or faster, or slower."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from allegro_twin.control.time_scaling import linear
from allegro_twin.control.trajectory import FASTEST, SLOWEST, Moves, Profile, Trajectory, Waypoint
from allegro_twin.errors import ConfigError
from allegro_twin.types import Array, Vector, frozen

STILL = 1e-9
"""rad/s: what rounding makes of a motion that goes nowhere."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Joint positions at times, with straight lines between them."""

    times: Vector
    """Ascending, shape (k,), s."""
    positions: Array
    """Shape (k, n), rad."""
    name: str = ""
    """In the library; empty for one that was only shown."""

    @property
    def seconds(self) -> float:
        """How long the motion takes once the hand is at its first position."""
        return float(np.ptp(self.times))

    def path(self, speed: float = 1.0) -> Trajectory:
        """The motion from its first position on, `speed` times as fast as it was shown. Raises ConfigError unless that
        is positive, and neither slower nor faster than a hand can be asked to move."""
        if not speed > 0.0:
            raise ConfigError(f"speed must be positive, as a multiple of the one it was shown at; it is {speed}")
        fastest = float(np.abs(np.diff(self.positions, axis=0) / np.diff(self.times)[:, None]).max())
        if fastest > STILL and not SLOWEST <= speed * fastest <= FASTEST:
            least, most = SLOWEST / fastest, FASTEST / fastest
            raise ConfigError(
                f"speed must be {least:.2g} to {most:.2g} times the one it was shown at, for joints from "
                f"{SLOWEST:g} to {FASTEST:g} rad/s; it is {speed:g}"
            )
        rows = tuple(frozen(row) for row in self.positions)
        times = (self.times - self.times[0]) / speed
        return Trajectory(tuple(times.tolist()), rows, (linear,) * (len(rows) - 1))

    def reference(self, speed: float = 1.0, profile: Profile = "minimum_jerk") -> Moves:
        """What a position controller follows: to the first position, with `speed` (rad/s) as its peak, then the motion
        as it was shown."""
        first = Waypoint(self.positions[0], speed=speed, profile=profile)
        legs = [
            Waypoint(position, seconds=float(after - before), profile="linear")
            for (before, after), position in zip(pairwise(self.times), self.positions[1:], strict=True)
        ]
        return Moves([first, *legs])
