"""Lost frames: four reports make one state of the hand, and their order on the bus shows where one is missing."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

N_FINGERS = 4
GAP = 0.75
"""Share of the period: no two reports of one period lie so far apart, and those of two periods do unless they were read
late. Four reports take 0.5 ms on a bus of 1 Mbit/s."""


PATIENCE = 2
"""Wholes in a row that may be thrown away for a gap."""


class Whole(NamedTuple):
    """All fingers of one period."""

    position: Any
    """The four reports' contents, joined, index to thumb: joint positions, rad, or the bytes that mean them."""
    t: float
    """When the last of them came, s."""


class Assembler:
    """A state is four reports that stand on the bus one after the other, index to thumb, after four that did too.

    The hand speaks in this order once a period, and a bus keeps order; when a frame was read says nothing where the
    host is late, and what it says repeats itself where a joint rests. So order alone decides. A report out of order, or
    frames that the receiver says it lost, cost that period and the next: the first four in order only show that the
    order holds again, since a late report could stand among them.

    What order cannot show is a loss of exactly four reports, or eight: then a gap between two stamps does, and costs
    that period. After two wholes in a row that were not used a gap counts for nothing: the host is late.
    """

    def __init__(self, period: float) -> None:
        self._gap = GAP * period
        self.group: list[Any] = []
        """The reports of a period that has begun."""
        self._trusted, self._gapped = True, False  # The order holds; the group has a gap.
        self._unused = 0  # Wholes in a row.
        self._last, self._finger = -math.inf, N_FINGERS
        self.periods = 0
        """Begun so far: those of which any report came."""
        self.incomplete = 0
        """Times that the order broke: a report was lost, late or double."""
        self.doubtful = 0
        """Wholes that were not used, because they may be of two periods."""
        self.heard = [-math.inf] * N_FINGERS
        """When each finger reported last, s."""
        self.reports = 0
        """Taken in so far."""

    def add(self, report: tuple[int, Any], t: float) -> Whole | None:
        """Take in a finger's number and what it reports; the whole hand, when this completes one to trust."""
        finger, content = report
        group, last = self.group, self._last
        self.heard[finger] = self._last = t
        self.reports += 1
        self.periods += finger <= self._finger
        self._finger = finger
        if finger != len(group):
            self._broken()
            if finger:
                return None
            group = self.group
        elif finger and t - last > self._gap:
            self._gapped = True
        group.append(content)
        if finger < N_FINGERS - 1:
            return None
        usable = self._trusted and not (self._gapped and self._unused < PATIENCE)
        self.group, self._gapped, self._trusted = [], False, True
        if not usable:
            self._unused += 1
            self.doubtful += 1
            return None
        self._unused = 0
        return Whole(group[0] + group[1] + group[2] + group[3], t)

    def add_all(self, content: Any, t: float) -> Whole | None:
        """Take in the reports of all fingers, joined, index to thumb, of one moment; as four times `add`. Only while
        no report of a period waits for the others."""
        self.heard = [t] * N_FINGERS
        self._last, self._finger = t, N_FINGERS - 1
        self.reports += N_FINGERS
        self.periods += 1
        if not self._trusted:
            self._trusted = True
            self._unused += 1
            self.doubtful += 1
            return None
        self._unused = 0
        return tuple.__new__(Whole, (content, t))

    def lost(self) -> None:
        """The receiver says that frames were lost: trust nothing until the order was seen again."""
        self.group, self._gapped, self._trusted = [], False, False

    def _broken(self) -> None:
        self.incomplete += self._trusted or bool(self.group)  # Once for what belongs together.
        self.lost()
