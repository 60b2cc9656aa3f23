"""Which period a whole hand belongs to, when stamps come from a host that is sometimes late."""

from __future__ import annotations

PATIENCE = 3
"""States in a row that must come late before a period counts as missed: one that is merely late is followed by one that
is not."""


class HandClock:
    """Counts periods by what the hand said, and corrects the count by the stamps.

    Every moment of which any frame came is a period. Moments of which nothing came show only in the stamps: at once
    when two or more are gone, after three late states when it is one.
    """

    def __init__(self, period: float, t: float, moments: int) -> None:
        self._period, self._begin, self._moments, self._late = period, t, moments, 0
        self.tick = 0
        """Periods since the first state."""
        self.t = 0.0
        """s since the first state; strictly increasing."""

    def advance(self, t: float, moments: int) -> int:
        """Take in a state with its stamp, s, and the number of moments begun so far; the periods since the last."""
        heard = max(moments - self._moments, 1)
        self._moments = moments
        gone = round((t - self._begin) / self._period) - (self.tick + heard)
        self._late = self._late + 1 if gone > 0 else 0
        if gone > 1 or self._late >= PATIENCE:
            heard, self._late = heard + gone, 0
        periods = max(heard + min(gone, 0), 1)  # A moment torn apart by a late host was counted twice.
        self.tick += periods
        # Time goes forward even where stamps do not.
        self.t = max(t - self._begin, self.t + 0.1 * self._period)
        return periods
