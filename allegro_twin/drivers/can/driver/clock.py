"""Hand clock: counts the periods between two states, with stamps of a host that may be late, and checks the
hand's period."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

PATIENCE = 3
"""States in a row that must come late before a period counts as missed: one that is merely late is followed by one that
is not."""
DRIFT = 0.001
"""Share of a state's lateness by which the expected time of the next ones moves: a hand's quartz is not the host's."""

EARLY, LATE = 0.25, 0.75
"""Periods by which a whole hand may come before its time or after it, while the count of periods is still beyond doubt:
a delay is never negative, so a hand that is less than one period late has lost none."""
WINDOW = 10
"""States of which the least lateness counts, for the hand's own period."""
LONGEST = 64
"""Windows over which it is looked for."""
STEADY, FASTEST = 2e-4, 0.02
"""Shares of a period: less than that is made up by DRIFT, and no quartz is off by more."""
BACKLOG = 0.5
"""Periods: two whole hands whose stamps are closer than this were read from a backlog, so the stamp of the later one
says when it was read, not when it came."""

OFF = 0.15
"""Share by which the rate of reports may differ from that of the period: no quartz is off by more than `FASTEST`, and
two whole milliseconds up to 7 are further apart."""
MARK, MARK_PERIODS = 0.05, 15
"""s, and periods, between two looks at the count of reports."""
SHORTEST, ENOUGH, SPAN = 2, 5, 30
"""Looks apart over which a rate is taken; looks after which a hand is found too fast; looks that are kept, after which
it is found too slow: 1.5 s."""
EXCUSED = 0.02
"""Share of the periods that may have had a loss, or have been read late, before a low rate is no period."""
AGREE, SCATTER = 0.1, 0.25
"""Shares of the mean interval by which the middle one, and the middle half of all, may differ from it where none was
lost."""


class Continuity:
    """Check whether the time between two whole hands is known: the count of the periods heard and the stamps must
    agree.

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
        self._told, self._doubt = period, 0.0  # What is learnt of it can be as wrong as it is large.
        self.periods = periods
        """Begun by the newest whole hand."""
        self.certain = True
        """Whether the newest whole hand came in its time."""
        self.epoch = 0
        """The count of periods between two whole hands of one epoch, both `certain`, is the truth."""
        self.backlog = False
        """Whether the newest whole hand waited to be read."""

    def tune(self, period: float) -> None:
        """The hand's own period, s, is known better now."""
        if period != self._period:
            self._begin += (self.periods - self._base) * self._period
            self._base, self._period = self.periods, period
            self._doubt = abs(period / self._told - 1.0)

    def hear(self, t: float, periods: int) -> None:
        """Take in a whole hand's stamp, s, and the number of periods begun so far."""
        period, passed, self.periods = self._period, periods - self.periods, periods
        late = (t - self._begin) / period - (periods - self._base)
        self.backlog = t - self._stamp < BACKLOG * period
        self._stamp, before, self._late = t, self._late, late
        if late < -EARLY:  # All before were late, or more was counted than there was.
            self._anchor(late)
            self._steady = 1
        elif late <= LATE - self._doubt * passed:
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


class QuartzRate:
    """Rate of a hand's quartz against the host's: how much longer its period is than requested.

    Host and adapter only ever delay a stamp, so the least lateness of ten states is near the truth. Where it goes the
    same way over four such windows, or four groups of 2, 4 or 16, by more than stamps scatter, the period is another
    one by the least of the three slopes. A loss is counted, and no slope; a host that is late catches up, and where one
    of the slopes is more than any quartz is off, all are of a host, or of periods that were counted too many.
    """

    def __init__(self) -> None:
        self.rate = 0.0
        """Share of the period that was told."""
        self.restart()

    def restart(self) -> None:
        """What comes is not to be compared with what came."""
        self._least: list[float] = []
        self._spread: list[float] = []
        self._window: list[float] = []

    def hear(self, late: float) -> float:
        """Take in by how many periods, as told, a state came later than by its count since the first. By how many the
        next one is later than it would have been before, if that changes the rate; else 0."""
        self._window.append(late)
        if len(self._window) < WINDOW:
            return 0.0
        least = min(self._window)
        self._spread = [*self._spread[1 - LONGEST :], sum(self._window) / WINDOW - least]
        self._least = [*self._least[1 - LONGEST :], least]
        self._window = []
        for group in (1, 2, 4, 16):
            if len(self._least) < 4 * group:
                break
            newest, span = self._least[-4 * group :], WINDOW * group
            leasts = [min(newest[k : k + group]) for k in range(0, 4 * group, group)]
            off = [(after - before) / span - self.rate for before, after in pairwise(leasts)]
            change = min(off, key=abs)
            scatter = sum(self._spread[-4 * group :]) / (4 * group)
            sudden = max(abs(self.rate + one) for one in off) > FASTEST + scatter / span
            if min(off) * max(off) > 0.0 and abs(change) > max(STEADY, scatter / (3 * span)) and not sudden:
                before, self.rate = self.rate, min(max(self.rate + change, -FASTEST), FASTEST)
                self.restart()
                return (self.rate - before) * 4 * span
        return 0.0


class HandClock:
    """Counts periods by what the hand said, and corrects the count by the stamps.

    Every period of which any report came is counted. Those of which nothing came show only in the stamps: at once when
    two or more are gone, after three late states when it is one. What is read from a backlog is stamped when it was
    read, so there the stamps only say how many periods there can have been at most: of a state that was late by two
    or more, and counted for lost, the periods come after it. The clock is the hand's: a period that is longer than it
    was told, steadily, is no loss.
    """

    def __init__(self, period: float, t: float, periods: int) -> None:
        self._period, self._origin, self._periods, self._late = period, t, periods, 0
        self._due = t  # Of the newest state.
        self._stamp, self._quartz = t, QuartzRate()
        self._counted = 0  # Periods that only the stamps have shown, and that were not heard since.
        self.tick = 0
        """Periods since the first state."""
        self.t = 0.0
        """s since the first state; strictly increasing."""

    @property
    def rate(self) -> float:
        """By which share the hand's period is longer than it was told."""
        return self._quartz.rate

    def advance(self, t: float, periods: int, *, caught_up: bool = True) -> int:
        """Take in a state with its stamp, s, and the number of periods begun so far; the periods since the last state.

        `caught_up`: nothing was left to read after it, so that its stamp says when it came.
        """
        heard = max(periods - self._periods, 1)
        self._periods = periods
        period = self._period * (1.0 + self.rate)
        if t < self._stamp - BACKLOG * self._period:  # A log, whose clock was set back.
            back = self._stamp + heard * period - t
            self._origin, self._due = self._origin - back, self._due - back
            self._quartz.restart()
        else:  # A little earlier is rounding, or the order in which an adapter stamps.
            t = max(t, self._stamp)
        self._stamp = t
        gone = round((t - self._due) / period - heard)
        if gone < 0:  # More was counted than there can have been: a late state, or a report out of its order.
            again = max(heard + gone, 1)
            self._counted = max(self._counted - (heard - again), 0)
            heard = again
        if not caught_up:
            self._pass(heard, period)
            self.t = max(min(self.t + heard * period, t - self._origin), self.t + 0.1 * self._period)
            return heard
        self._late = self._late + 1 if gone > 0 else 0
        if gone > 1 or self._late >= PATIENCE:
            heard, self._late = heard + gone, 0
            self._counted += gone
        self._pass(heard, period)
        if not self._late:
            self._follow(t, period)
            self._due += self._period * self._quartz.hear((t - self._origin) / self._period - self.tick)
        self.t = max(t - self._origin, self.t + 0.1 * self._period)  # Forward even where stamps are not.
        return heard

    def _pass(self, periods: int, period: float) -> None:
        self.tick += periods
        self._due += periods * period

    def _follow(self, t: float, period: float) -> None:
        """Learn when the next states are due from one that came in its time."""
        late = (t - self._due) / period
        if late < -(self._counted + 0.5):  # Nobody is that early: it was due before.
            self._due += (late + self._counted) * period
        elif abs(late) <= 0.5:
            self._due += DRIFT * late * period


def steady(intervals: Sequence[float]) -> float:
    """The period of something periodic, s: the mean interval, where the middle half of them says the same; NaN where it
    does not, since some were lost, or read in bunches."""
    mean, quarters = float(np.mean(intervals)), np.percentile(intervals, (25, 50, 75))
    return mean if (np.abs(quarters - mean) < mean * np.array((SCATTER, AGREE, SCATTER))).all() else math.nan


class _Look(NamedTuple):
    t: float
    wholes: int
    periods: int
    excuses: int


class PeriodCheck:
    """Check whether a hand keeps the requested period, by its reports a second.

    A bunch of reports after a stall comes faster than any hand, but the time of the stall is before it: what has come
    too fast over every span from 0.1 s to 1.5 s, or to the session's first report, is a hand with a shorter period.
    What has come too slowly over all of them may have been lost, or be left for later by a slow host. It is a longer
    period where nothing says so, and where the intervals are even.
    """

    def __init__(self, period: float) -> None:
        self._period, self._mark = period, max(MARK, MARK_PERIODS * period)
        self._looks = deque[_Look](maxlen=SPAN + 1)
        self._stamps = deque[float](maxlen=SPAN * MARK_PERIODS // 2)
        self._wholes, self._begin, self._next = 0, math.inf, -math.inf
        self.found = math.nan
        """The hand's own period, s, where that is clearly another one; else NaN."""

    def hear(self, t: float, periods: int, excuses: int) -> None:
        """Take in a whole hand's stamp, s, the periods begun so far, and how often something was lost or read late."""
        self._wholes += 1
        self._stamps.append(t)
        if self._begin <= t < self._next:
            return
        if t < self._begin < math.inf:  # A log, whose clock was set back.
            self._looks.clear()
            self._stamps.clear()
        self._begin, self._next = t, t + self._mark
        self._looks.append(_Look(t, self._wholes, periods, excuses))
        self.found = self._judge() if len(self._looks) > ENOUGH else math.nan

    def _judge(self) -> float:
        looks, least = list(self._looks), 1.0 + OFF
        now, before = looks[-1], looks[:-SHORTEST]
        if all((now.wholes - look.wholes) * self._period > least * (now.t - look.t) for look in before):
            recent = looks[-1 - ENOUGH]
            return (now.t - recent.t) / (now.wholes - recent.wholes)
        if len(looks) <= SPAN or now.excuses - looks[0].excuses > EXCUSED * (now.periods - looks[0].periods):
            return math.nan
        if all((now.periods - look.periods) * self._period * least < now.t - look.t for look in before):
            found = steady(np.diff(self._stamps).tolist())
            return found if found > least * self._period else math.nan
        return math.nan
