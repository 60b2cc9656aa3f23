"""Which period a whole hand belongs to, when stamps come from a host that is sometimes late."""

from __future__ import annotations

PATIENCE = 3
"""States in a row that must come late before a period counts as missed: one that is merely late is followed by one that
is not."""
DRIFT = 0.001
"""Share of a state's lateness by which the expected time of the next ones moves: a hand's quartz is not the host's."""


class HandClock:
    """Counts periods by what the hand said, and corrects the count by the stamps.

    Every period of which any report came is counted. Those of which nothing came show only in the stamps: at once when
    two or more are gone, after three late states when it is one. What is read from a backlog is stamped when it was
    read, so there the count alone holds.
    """

    def __init__(self, period: float, t: float, periods: int) -> None:
        self._period, self._origin, self._begin, self._periods, self._late = period, t, t, periods, 0
        self._stamp = t
        self.tick = 0
        """Periods since the first state."""
        self.t = 0.0
        """s since the first state; strictly increasing."""

    def advance(self, t: float, periods: int, *, caught_up: bool = True) -> int:
        """Take in a state with its stamp, s, and the number of periods begun so far; the periods since the last state.

        `caught_up`: nothing was left to read after it, so that its stamp says when it came.
        """
        heard = max(periods - self._periods, 1)
        self._periods = periods
        if t < self._stamp:  # A log, whose clock was set back.
            back = self._stamp + heard * self._period - t
            self._origin, self._begin = self._origin - back, self._begin - back
        self._stamp = t
        if not caught_up:
            self.tick += heard
            self.t = max(min(self.t + heard * self._period, t - self._origin), self.t + 0.1 * self._period)
            return heard
        late = t - self._begin - (self.tick + heard) * self._period
        gone = round(late / self._period)
        self._late = self._late + 1 if gone > 0 else 0
        if gone > 1 or self._late >= PATIENCE:
            heard, self._late = heard + gone, 0
        elif gone < 0:  # More was counted than there can have been: a report out of its order.
            heard = max(heard + gone, 1)
        elif gone == 0:
            self._begin += DRIFT * late
        self.tick += heard
        self.t = max(t - self._origin, self.t + 0.1 * self._period)  # Forward even where stamps are not.
        return heard
