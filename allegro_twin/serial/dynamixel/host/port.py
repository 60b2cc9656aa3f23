"""A serial port as a line: behind the names that the vendor's packet handler asks for."""

from __future__ import annotations

import time

from allegro_twin.serial.dynamixel.host.line import Line
from allegro_twin.serial.line.adapter import Adapter
from allegro_twin.serial.line.port import BITS, FLOOD, LATENCY


class SerialLine(Line):
    """A real port, for this program alone; or a terminal at whose other end a virtual hand is."""

    def __init__(self, path: str, baud: int, latency: float = LATENCY) -> None:
        super().__init__(path, baud)
        self._latency, self._overdue, self._left = latency, 0.0, FLOOD
        self._port = Adapter(path, baud)

    def now(self) -> float:
        return self._port.now()

    def wait(self, until: float) -> None:
        self._port.wait(until)

    def begin(self) -> None:
        self._port.clear()

    def rebaud(self, baud: int) -> None:
        self._port.rebaud(baud)
        self.baud = baud

    def close(self) -> None:
        self._port.close()

    @property
    def shared(self) -> int | None:
        return self._port.shared

    def clearPort(self) -> None:  # noqa: N802  # The SDK's name, as are those below.
        self._port.clear()

    def writePort(self, packet: list[int]) -> int:  # noqa: N802
        self._port.send(bytes(packet))
        return len(packet)

    def readPort(self, length: int) -> bytes:  # noqa: N802
        data = self._port.receive(min(length, self._left), self._overdue - time.monotonic())
        self._left -= len(data)
        return data

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        self._overdue, self._left = time.monotonic() + packet_length * BITS / self.baud + self._latency, FLOOD

    def setPacketTimeoutMillis(self, msec: float) -> None:  # noqa: N802
        self._overdue, self._left = time.monotonic() + 1e-3 * msec, FLOOD

    def isPacketTimeout(self) -> bool:  # noqa: N802
        return self._left <= 0 or time.monotonic() > self._overdue
