"""A motion that a person shows to a hand: recorded, trimmed, simplified, and repeated at another speed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from allegro_twin.control.time_scaling import linear
from allegro_twin.control.trajectory import SLOWEST, Moves, Profile, Trajectory, Waypoint, number
from allegro_twin.errors import ConfigError
from allegro_twin.types import Array, Vector, frozen

STILL = 1e-9
"""rad/s: what rounding makes of a motion that goes nowhere."""


@dataclass(frozen=True, slots=True, eq=False)
class TaughtMotion:
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
        is positive and finite, and no slower than a hand can be asked to move."""
        if not 0.0 < number(speed, "speed") < math.inf:
            raise ConfigError(f"speed must be positive, as a multiple of the one it was shown at; it is {speed}")
        fastest = float(np.abs(np.diff(self.positions, axis=0) / np.diff(self.times)[:, None]).max())
        if fastest > STILL and speed * fastest < SLOWEST:
            raise ConfigError(
                f"speed must be at least {SLOWEST / fastest:.2g} times the one it was shown at, for joints from "
                f"{SLOWEST:g} rad/s; it is {speed:g}"
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


def trim_demonstration(
    times: Array, positions: Array, *, still: float = 0.01, tolerance: float = 0.004
) -> TaughtMotion:
    """The motion in a record of joint positions, trimmed and simplified. Raises ConfigError when nothing moved.

    What lies within `still` (rad) of the first or the last position at either end is waiting. Between its knots the
    result runs straight in time and leaves the record nowhere by more than `tolerance` (rad) in any joint.
    """
    begin = int(np.argmax((np.abs(positions - positions[0]) > still).any(axis=1)))
    moving = (np.abs(positions - positions[-1]) > still).any(axis=1)
    if not moving.any():
        raise ConfigError(f"nothing was taught: no joint moved by more than {still} rad")
    end = len(positions) - int(np.argmax(moving[::-1]))
    # Of a motion that is hardly longer than `still` all may be waiting, at the one end or the other.
    begin, end = max(min(begin, end) - 1, 0), min(max(begin, end), len(positions) - 1)
    keep = _knots(times[begin : end + 1], positions[begin : end + 1], tolerance)
    return TaughtMotion(times[begin + keep] - times[begin], positions[begin + keep])


def _knots(times: Array, positions: Array, tolerance: float) -> Array:
    """Row indices to keep: the ends, and wherever a straight line in time would miss a row (Douglas and Peucker)."""
    keep = {0, len(times) - 1}
    spans = [(0, len(times) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        part = ((times[first : last + 1] - times[first]) / (times[last] - times[first]))[:, None]
        straight = positions[first] + part * (positions[last] - positions[first])
        missed = np.abs(positions[first : last + 1] - straight).max(axis=1)
        worst = int(np.argmax(missed))
        if missed[worst] > tolerance:
            keep.add(first + worst)
            spans += [(first, first + worst), (first + worst, last)]
    return np.array(sorted(keep))
