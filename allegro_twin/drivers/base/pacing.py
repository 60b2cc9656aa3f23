"""The steps of virtual hands in real time: when each is due, and what was heard and said meanwhile."""

from __future__ import annotations

from collections.abc import Callable

BEHIND = 1.0
"""s of lateness at which a hand gives up catching up: a real hand's clock does not wait either."""


class Served:
    """Progress of a served hand. Deadlines are absolute, so that lateness does not add up."""

    def __init__(self, period: float, clock: Callable[[], float], unit: str) -> None:
        """`period`: s of a step; `clock`: s that never go back; `unit`: what is heard and said."""
        self._period, self._clock, self._begin, self._unit = period, clock, clock(), unit
        self.steps = self.heard = self.sent = 0
        """Steps; what the host sent, and what was sent to it."""
        self.unsaid = 0
        """What a full transmit queue did not take."""
        self.late = self.lost = 0
        """Steps that ended more than a step late, and steps that were left out to catch up."""

    @property
    def due(self) -> float:
        """When the step that runs is over, s."""
        return self._begin + (self.steps + self.lost + 1) * self._period

    def count(self) -> None:
        """The step that runs is over."""
        late = self._clock() - self.due
        if late > BEHIND:
            self.lost += int(late / self._period)
        self.late += late > self._period
        self.steps += 1

    def summary(self) -> str:
        """All of it in one line."""
        steps = f"{self.steps} steps, {self.late} late, {self.lost} left out"
        return f"{steps}; {self.heard} {self._unit} heard, {self.sent} said"
