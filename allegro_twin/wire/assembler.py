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

    A report that comes twice is taken once. A moment is thrown away, until the bus was quiet for half a period, when a
    finger contradicts itself in it, and when it follows one that lacked a finger: what is missing may still be under
    way and would arrive among the next reports. Trust returns when all fingers have reported equally often, or after a
    moment in which each did once, beginning with the usual one. So a lost report costs two periods. Where a busy host
    leaves no quiet between moments, two rounds in the usual order restore trust, and the order then tells moments apart
    until it is broken or there is quiet. It takes a copy of a report that comes more than half a period after its
    moment began, or two faults at once, to deceive it.
    """

    def __init__(self, period: float) -> None:
        self._window = period / 2
        self._group: dict[int, Four] = {}
        self._done: dict[int, Four] = {}
        self._begin = self._last = -math.inf
        self._open = False  # A moment has begun and is neither whole nor thrown away.
        self._thrown = False
        self._since = [0] * N_FINGERS  # Reports since the last whole.
        self._first = self._usual = (
            0  # The finger that the last whole began with, and two in a row: on a bus the index.
        )
        self._own: list[int] = []  # Who reported in a moment that was thrown away.
        self._order = list(range(N_FINGERS))  # In which the reports of the last whole came.
        self._rounds = False  # The host is so busy that only the order tells moments apart.
        self._done_at = -math.inf
        self.moments = 0
        """Begun so far: periods of which any report came."""
        self.incomplete = 0
        """Moments of which some finger was lost or late."""
        self.doubtful = 0
        """Moments thrown away because their reports may be of two periods."""
        self.heard = [-math.inf] * N_FINGERS
        """When each finger reported last, s."""

    def add(self, report: FingerPosition, t: float) -> Whole | None:
        """The whole hand, when this report completes it."""
        finger, position = report
        self.heard[finger] = t
        quiet, self._last = t - self._last > self._window, t
        if quiet or (not self._thrown and not self._rounds and t - self._begin > self._window):
            self._next(t)
        elif self._rounds and finger != self._order[len(self._group)]:
            self._rounds = False
            self._throw()
        elif not self._open and not self._thrown and self._done.get(finger) != position:
            self._begin_at(t)  # Stamps lie closer than reports when the host was late.
        if self._thrown:
            self._own.append(finger)
            self._since[finger] += 1
            if self._own[-2 * N_FINGERS :] == 2 * self._order:
                self._group, self._own, self._since = {}, [], [0] * N_FINGERS
                self._thrown, self._rounds = False, True
            return None
        group = self._group
        if finger in group:
            if group[finger] != position:
                self._since[finger] += 1
                self._throw()
            return None
        group[finger] = position
        self._since[finger] += self._open
        if len(group) < N_FINGERS:
            return None
        news, self._open = self._open, False
        if not news and t - self._done_at > self._window:  # Not copies, but a hand at rest that a late host hears.
            self.moments, news = self.moments + 1, True
        self._order = list(group)
        first = self._order[0]
        self._usual, self._first = (first if first == self._first else self._usual), first
        self._done, self._group, self._since = group, {}, [0] * N_FINGERS
        if not news:
            return None
        self._done_at = t
        return Whole(group[0] + group[1] + group[2] + group[3], t)

    def silent(self, since: float) -> list[int]:
        """Fingers that have not reported since then."""
        return [finger for finger, t in enumerate(self.heard) if t < since]

    def _next(self, t: float) -> None:
        """Half a period has passed since a report, or since the moment began."""
        self.incomplete += self._open
        trusted = len(set(self._since)) == 1 or self._regular()
        self._group, self._own, self._thrown, self._rounds = {}, [], False, False
        self._begin_at(t)
        if trusted:
            self._since = [0] * N_FINGERS
        else:
            self._throw()

    def _regular(self) -> bool:
        """Whether a moment that was thrown away was in itself as it should be."""
        own = self._own
        return len(own) == len(set(own)) == N_FINGERS and own[0] == self._usual

    def _begin_at(self, t: float) -> None:
        self._begin, self._open = t, True
        self.moments += 1
        for finger in self._group:
            self._since[finger] += 1

    def _throw(self) -> None:
        self._thrown, self._open = True, False
        self.doubtful += 1
        self._group.clear()
