"""From four reports to one hand: reports belong together when they arrive within half a period of each other."""

from __future__ import annotations

import math
from typing import NamedTuple

from allegro_twin.wire.messages import FingerPosition, Four

N_FINGERS = 4


class Whole(NamedTuple):
    """All fingers of one moment."""

    position: tuple[float, ...]
    """Index to thumb, palm outward, rad."""
    t: float
    """When the last of them arrived, s."""


class Assembler:
    """Groups reports by time, never by their order, so that no state is put together from two periods.

    A report that comes twice is taken once. One that contradicts an earlier of its finger makes the moment doubtful:
    nothing is made of it until the bus was quiet for half a period.
    """

    def __init__(self, period: float) -> None:
        self._window = period / 2
        self._group: dict[int, Four] = {}
        self._done: dict[int, Four] = {}
        self._begin = self._last = -math.inf
        self._doubtful = False
        self.moments = 0
        """Begun so far: periods of which any report came."""
        self.incomplete = 0
        """Moments of which some finger was lost."""
        self.doubtful = 0
        """Moments thrown away because a finger contradicted itself."""
        self.heard = [-math.inf] * N_FINGERS
        """When each finger reported last, s."""

    def add(self, report: FingerPosition, t: float) -> Whole | None:
        """The whole hand, when this report completes it."""
        finger, position = report
        self.heard[finger] = t
        quiet, self._last = t - self._last > self._window, t
        if self._doubtful and not quiet:
            return None
        if quiet or t - self._begin > self._window:
            self._forget()
            self._begin = t
        group = self._group
        if not group:
            self._begin = t
            self.moments += self._done.get(finger) != position or quiet
        elif finger in group:
            if group[finger] != position:
                self._doubtful = True
                self.doubtful += 1
                group.clear()
            return None
        group[finger] = position
        if len(group) < N_FINGERS:
            return None
        self._done, self._group = group, {}
        return Whole(group[0] + group[1] + group[2] + group[3], t)

    def silent(self, since: float) -> list[int]:
        """Fingers that have not reported since then."""
        return [finger for finger, t in enumerate(self.heard) if t < since]

    def _forget(self) -> None:
        """Begin a new moment. What only repeated the last one was not a moment."""
        if any(self._done.get(finger) != position for finger, position in self._group.items()):
            self.incomplete += 1
        self._group = {}
        self._doubtful = False
