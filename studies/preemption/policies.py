"""When a hand begins to close: pure functions of what is seen of the arm and of the thing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.types import Array
from studies.preemption.protocol import Policy

Yes = NDArray[np.bool_]


class Seen(NamedTuple):
    """Of some trials at one moment, (k,) each."""

    t: float
    """Since the arm set off, s."""
    arrival: Array
    """When it is to arrive, s."""
    settled: Yes
    """It has, and rests."""
    remaining: Array
    """From the palm to where it grasps, m."""
    speed: Array
    """Of the palm, m/s."""
    force: Array
    """With which the hand has touched the thing so far, at most, N."""
    width: Array
    """Of the thing, m."""
    sigma: Array
    """Standard deviation of its place, m."""


def begins(policy: Policy, seen: Seen, closing: float) -> Yes:
    """In which of the trials the hand closes now, if it has not yet. `closing`: how long it takes, s. What a policy
    waits for may never come, so that each closes the hand once the arm has settled, at the latest."""
    match policy.begins:
        case "arrival":
            return seen.settled
        case "overlap":
            return np.asarray(seen.t >= seen.arrival - policy.overlap * closing - 1e-9) | seen.settled
        case "distance":
            near = policy.margin + policy.per_width * seen.width + policy.per_speed * seen.speed
            return np.asarray(seen.remaining <= near + policy.per_sigma * seen.sigma) | seen.settled
        case "contact":
            return np.asarray(seen.force > policy.force) | seen.settled


def due(rate: float | None, phase: Array, t: float, period: float) -> Yes:
    """In which trials a state machine looks at this moment, one of every `period` s: at its `rate`, Hz, from `phase`,
    (k,), a part of its cycle, on; always where it has none."""
    if rate is None:
        return np.ones(len(phase), dtype=np.bool_)
    cycles = (t + 1e-9) * rate - phase
    return np.asarray(np.floor(cycles) > np.floor(cycles - period * rate))
