"""Which period a whole hand belongs to, and how many lie between two, when stamps come from a host that may be late."""

from __future__ import annotations

import math

PATIENCE = 3
"""States in a row that must come late before a period counts as missed: one that is merely late is followed by one that
is not."""
DRIFT = 0.001
"""Share of a state's lateness by which the expected time of the next ones moves: a hand's quartz is not the host's."""

EARLY, LATE = 0.25, 0.75
"""Periods by which a whole hand may come before its time or after it, while the count of periods is still beyond doubt:
a delay is never negative, so a hand that is less than one period late has lost none."""
BACKLOG = 0.5
"""Periods: two whole hands whose stamps are closer than this were read from a backlog, so the stamp of the later one
says when it was read, not when it came."""


class Continuity:
    """Whether the time between two whole hands is known: the count of the periods heard and the stamps must agree.

    The count alone misses periods of which nothing was heard: of a receive buffer that ran over, the end of the old
    reports and the beginning of the new ones stand in order, one after the other. The stamps alone are those of a host,
    or of an adapter, that is sometimes late. A whole hand whose lateness by the count is that of no whole period is in
    time, and the count from the last one that was in time is the truth. While a hand is later than that, nothing is
    known; what stays late over `PATIENCE` whole hands, and does not catch up, was lost.

    Every whole hand passes through `hear`, used as a state or not.
    """

    def __init__(self, period: float, t: float, periods: int) -> None:
        self._period, self._begin, self._base = period, t, periods  # `_begin`: of period `_base`, at the least delay.
        self._stamp, self._late, self._run, self._steady = -math.inf, 0.0, 0, PATIENCE
        self.periods = periods
        """Begun by the newest whole hand."""
        self.certain = True
        """Whether the newest whole hand came in its time."""
        self.epoch = 0
        """The count of periods between two whole hands of one epoch, both `certain`, is the truth."""
        self.backlog = False
        """Whether the newest whole hand waited to be read."""

    def hear(self, t: float, periods: int) -> None:
        """Take in a whole hand's stamp, s, and the number of periods begun so far."""
        period, self.periods = self._period, periods
        late = (t - self._begin) / period - (periods - self._base)
        self.backlog = t - self._stamp < BACKLOG * period
        self._stamp, before, self._late = t, self._late, late
        if late < -EARLY:  # All before were late, or more was counted than there was.
            self._anchor(late)
            self._steady = 1
        elif late <= LATE:
            self._run, self._steady = 0, self._steady + 1
            self._begin += period * (late if late < 0.0 else min(late, DRIFT))
        else:
            self._run = self._run + 1 if late > before - BACKLOG else 1
            if self._run >= PATIENCE:
                self._anchor(math.floor(late + EARLY))
                self._steady = PATIENCE
                self.certain = True
                return
        self.certain = self._run == 0 and self._steady >= PATIENCE

    def lost(self) -> None:
        """The receiver says that frames were lost."""
        self.epoch += 1

    def _anchor(self, late: float) -> None:
        """Count from here on anew, so many periods later."""
        self._begin, self._run = self._begin + late * self._period, 0
        self._late -= late
        self.epoch += 1


class HandClock:
    """Counts periods by what the hand said, and corrects the count by the stamps.

    Every period of which any report came is counted. Those of which nothing came show only in the stamps: at once when
    two or more are gone, after three late states when it is one. What is read from a backlog is stamped when it was
    read, so there the stamps only say how many periods there can have been at most: of a state that was late by two
    or more, and counted for lost, the periods come after it.
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
        if t < self._stamp - BACKLOG * self._period:  # A log, whose clock was set back.
            back = self._stamp + heard * self._period - t
            self._origin, self._begin = self._origin - back, self._begin - back
        else:  # A little earlier is rounding, or the order in which an adapter stamps.
            t = max(t, self._stamp)
        self._stamp = t
        late = t - self._begin - (self.tick + heard) * self._period
        gone = round(late / self._period)
        if gone < 0:  # More was counted than there can have been: a late state, or a report out of its order.
            heard = max(heard + gone, 1)
        if not caught_up:
            self.tick += heard
            self.t = max(min(self.t + heard * self._period, t - self._origin), self.t + 0.1 * self._period)
            return heard
        self._late = self._late + 1 if gone > 0 else 0
        if gone > 1 or self._late >= PATIENCE:
            heard, self._late = heard + gone, 0
        elif gone == 0:
            self._begin += DRIFT * late
        self.tick += heard
        self.t = max(t - self._origin, self.t + 0.1 * self._period)  # Forward even where stamps are not.
        return heard
