"""A virtual hand in the program that drives it: only waiting for the next period lets its time pass."""

from __future__ import annotations

from allegro_twin.serial.dynamixel.device.hand import VirtualHand
from allegro_twin.serial.dynamixel.host.line import Line

_EPSILON = 1e-6  # Of a step: sums of periods are rounded.


class LockstepLine(Line):
    """The way to it. Deterministic: an answer is there at once or never, however slow the host is."""

    lockstep = True

    def __init__(self, hand: VirtualHand, baud: int) -> None:
        super().__init__(f"virtual {hand.backend.spec.name}", baud)
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
        self.clearPort()

    def rebaud(self, baud: int) -> None:
        self.baud = baud
        self.hand.bus.clear()
        self.clearPort()

    def close(self) -> None:
        self.clearPort()

    def clearPort(self) -> None:  # noqa: N802  # The SDK's name, as are those below.
        self._came, self._at = b"", 0

    def writePort(self, packet: list[int]) -> int:  # noqa: N802
        self._came = self._came[self._at :] + self.hand.receive(bytes(packet), self.baud)
        self._at = 0
        return len(packet)

    def readPort(self, length: int) -> bytes:  # noqa: N802
        data = self._came[self._at : self._at + length]
        self._at += len(data)
        return data

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        pass  # What has not come by now will not come.

    def setPacketTimeoutMillis(self, msec: float) -> None:  # noqa: N802
        pass

    def isPacketTimeout(self) -> bool:  # noqa: N802
        return self._at >= len(self._came)
