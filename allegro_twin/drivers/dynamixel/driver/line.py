"""A port behind the names that the vendor's packet handler asks for."""

from __future__ import annotations

from allegro_twin.drivers.base.serial_line import BITS, FLOOD, LATENCY, SerialLine

# The SDK's names.
# ruff: noqa: N802


class SdkLine:
    """A port as `dynamixel_sdk` wants one. Raises LinkError for whatever ends it."""

    is_using = False
    """The packet handler's own mark that an answer is awaited."""

    def __init__(self, port: SerialLine, latency: float = LATENCY) -> None:
        """`latency`: s that an answer may take beside its bytes."""
        self.port, self._latency = port, latency
        self._overdue, self._left = 0.0, FLOOD
        self._returned = b""

    def getBaudRate(self) -> int:
        return self.port.baud

    def clearPort(self) -> None:
        """Forget what was received."""
        self._returned = b""
        self.port.clear()

    def writePort(self, packet: list[int]) -> int:
        """Send; the number of bytes that went out."""
        self.port.send(bytes(packet))
        return len(packet)

    def readPort(self, length: int) -> bytes:
        """So many bytes at most, waiting for the first until the answer is overdue."""
        if self._returned:
            data, self._returned = self._returned[:length], self._returned[length:]
            return data
        data = self.port.receive(min(length, self._left), self._overdue - self.port.now())
        self._left -= len(data)
        if not data and self.port.lockstep:
            self._left = 0  # What has not come by now will not come.
        return data

    def take(self, length: int) -> bytes:
        """So many bytes, or those that came until the answer was overdue."""
        said = b""
        while len(said) < length and not self.isPacketTimeout():
            said += self.readPort(length - len(said))
        return said

    def give_back(self, data: bytes) -> None:
        """Bytes that were taken are read once more, before all others."""
        self._returned = data + self._returned

    def setPacketTimeout(self, packet_length: int) -> None:
        """An answer of so many bytes is awaited from now on."""
        self._wait(packet_length * BITS / self.port.baud + self._latency)

    def setPacketTimeoutMillis(self, msec: float) -> None:
        self._wait(1e-3 * msec)

    def isPacketTimeout(self) -> bool:
        """Whether the answer is overdue."""
        return self._left <= 0 or self.port.now() > self._overdue

    def _wait(self, seconds: float) -> None:
        self._overdue, self._left = self.port.now() + seconds, FLOOD
