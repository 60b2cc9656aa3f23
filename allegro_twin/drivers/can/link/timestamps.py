"""Timestamps of frames on the host's steady clock, from stamps of any clock."""

from __future__ import annotations

import math

CREEP = 1e-3
"""By which two clocks may drift apart; the kernel slews its own by at most half of it (adjtimex)."""
SET_BACK = 1e-3
"""s before which a frame cannot have come: then the stamps' clock was set."""


class Stamps:
    """stamp + offset, where the offset is the least delay between a stamp and its reading that was ever seen.

    The result is never after the reading nor before the queue was last seen empty, so a clock that is set (NTP after
    boot) moves nothing: the offset is found anew.
    """

    def __init__(self) -> None:
        self._offset, self._seen = math.inf, 0.0
        self._floor = -math.inf

    @property
    def offset(self) -> float | None:
        """What to add to a stamp, s; None before the first."""
        return None if math.isinf(self._offset) else self._offset

    def empty(self, now: float) -> None:
        """Nothing was waiting to be read at `now`, s: what comes next comes later."""
        self._floor = max(self._floor, now)

    def __call__(self, stamp: float, now: float) -> float:
        """The time of a frame that was read at `now`, s; 0 stands for no stamp."""
        if not stamp:
            return now
        offset = min(now - stamp, self._offset + CREEP * (now - self._seen))
        if stamp + offset < self._floor - SET_BACK:
            offset = now - stamp
        self._offset, self._seen = offset, now
        self._floor = max(min(stamp + offset, now), self._floor)
        return self._floor
