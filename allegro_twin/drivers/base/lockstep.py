"""A virtual hand in the program that drives it: only waiting for the next period lets its time pass."""

from __future__ import annotations

from typing import Protocol

from allegro_twin.drivers.base.serial_line import SerialLine
from allegro_twin.drivers.base.serve import SerialDevice

_EPSILON = 1e-6  # Of a step: sums of periods are rounded.


class Steppable(SerialDevice, Protocol):
    """A hand that does not exist, whose time is its own."""

    @property
    def name(self) -> str: ...

    @property
    def now(self) -> float:
        """s since `restart`."""
        ...

    def restart(self) -> None:
        """Begin the scene anew; the electronics stay as they are."""
        ...


class LockstepLine(SerialLine):
    """The way to it. Deterministic: an answer is there at once or never, however slow the host is."""

    lockstep = True

    def __init__(self, hand: Steppable, baud: int) -> None:
        super().__init__(f"virtual {hand.name}", baud)
        self.hand = hand
        self._came, self._at = b"", 0
        """What has come, and how much of it was read."""

    def now(self) -> float:
        return self.hand.now

    def wait(self, until: float) -> None:
        hand = self.hand
        while hand.now < until - _EPSILON * hand.period:
            hand.step()

    def begin(self) -> None:
        self.hand.restart()
        self.clear()

    def rebaud(self, baud: int) -> None:
        self.baud = baud
        self.hand.clear()
        self.clear()

    def clear(self) -> None:
        self._came, self._at = b"", 0

    def send(self, data: bytes) -> None:
        self._came, self._at = self._came[self._at :] + self.hand.receive(data, self.baud), 0

    def receive(self, most: int, seconds: float) -> bytes:
        data = self._came[self._at : self._at + most]
        self._at += len(data)
        if not data:
            self.hand.clear()  # Whoever waits in vain makes a pause on the line.
        return data

    def close(self) -> None:
        self.clear()
