"""Times of a bag's messages: all by their stamps or, where none has one, all by when they were recorded."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

JUMP = 10 * 10**9
"""ns by which stamps go further on than the recorder's clock, from which on they are of another clock."""


class BagTimes(NamedTuple):
    """Times of messages, and which of them one clock tells."""

    times: NDArray[np.int64]
    """(k,), ns."""
    kept: NDArray[np.bool_]
    """(k,): the most messages whose times increase, without a jump ahead."""
    stamped: bool
    """By the messages' own stamps."""

    def left_out(self, what: str) -> list[str]:
        """Say which messages are left out, and why; nothing where all are kept. `what`: messages, in the plural."""
        count = len(self.times)
        repeats = ~self.kept & np.isin(self.times, self.times[self.kept])
        said = []
        for row, why in ((repeats, "repeat that of another"), (~self.kept & ~repeats, "go back, or jump")):
            if row.any():
                first = int(np.argmax(row)) + 1
                said.append(f"{row.sum()} of {count} {what} are left out: their times {why}, first that of {first}")
        if not self.stamped and count:
            said.append(f"{what} have no stamps: their times are when they were recorded")
        return said


def bag_times(stamps: Sequence[int], recorded: Sequence[int]) -> BagTimes:
    """Judge the messages of a bag as a whole, by their stamps and the times when they were recorded, ns, in the order
    of the bag. A stamp of 0 is a time unless all are 0: simulated time begins there."""
    own, clock = np.array(stamps, dtype=np.int64), np.array(recorded, dtype=np.int64)
    stamped = bool(own.any())
    times = own if stamped else clock
    rows = _longest_increasing(times.tolist())
    ahead = np.diff(times[rows]) - np.diff(clock[rows])
    parts = np.split(rows, np.flatnonzero(ahead > JUMP) + 1)
    kept = np.zeros(len(times), np.bool_)
    kept[max(parts, key=len)] = True
    return BagTimes(times, kept, stamped)


def _longest_increasing(times: Sequence[int]) -> NDArray[np.intp]:
    """Indices of the most rows whose times increase."""
    ends: list[int] = []  # Of the increasing rows of each length: the last one's index, and its time, the least.
    least: list[int] = []
    before: list[int] = []
    for row, time in enumerate(times):
        place = bisect_left(least, time)
        before.append(ends[place - 1] if place else -1)
        if place < len(least) and least[place] == time:
            continue  # The first message of a time stands for it.
        ends[place : place + 1], least[place : place + 1] = [row], [time]
    found = []
    row = ends[-1] if ends else -1
    while row >= 0:
        found.append(row)
        row = before[row]
    return np.array(found[::-1], dtype=np.intp)
