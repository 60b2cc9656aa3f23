"""A virtual hand in the program that drives it: only waiting for the next period lets its time pass."""

from __future__ import annotations

from allegro_twin.serial.line.port import Port
from allegro_twin.serial.polled.device import VirtualHand

_EPSILON = 1e-6  # Of a step: sums of periods are rounded.


class LockstepPort(Port):
    """The way to it. Deterministic: an answer is there at once or never, however slow the host is."""

    lockstep = True

    def __init__(self, hand: VirtualHand, baud: int) -> None:
        super().__init__(f"virtual {hand.backend.spec.name}", baud)
        self.hand = hand
        self._came = b""

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
        self._came = b""

    def send(self, data: bytes) -> None:
        self._came += self.hand.receive(data, self.baud)

    def receive(self, most: int, seconds: float) -> bytes:
        data, self._came = self._came[:most], self._came[most:]
        if not data:
            self.hand.clear()  # Whoever waits in vain makes a pause on the line.
        return data

    def close(self) -> None:
        self.clear()
