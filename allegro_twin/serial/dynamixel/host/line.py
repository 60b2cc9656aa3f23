"""The line to a hand of servos: what the vendor's packet handler speaks through, and the time that passes on it."""

from __future__ import annotations

from abc import abstractmethod

from allegro_twin.serial.line.port import Timed

# The SDK's packet handler asks for these names.
# ruff: noqa: N802


class Line(Timed):
    """A port as `dynamixel_sdk` wants one, with a clock. Raises LinkError for whatever ends it."""

    is_using = False
    """The packet handler's own mark that an answer is awaited."""

    def getBaudRate(self) -> int:
        return self.baud

    @abstractmethod
    def clearPort(self) -> None:
        """Forget what was received."""

    @abstractmethod
    def writePort(self, packet: list[int]) -> int:
        """Send; the number of bytes that went out."""

    @abstractmethod
    def readPort(self, length: int) -> bytes:
        """So many bytes at most, waiting for the first until the answer is overdue."""

    @abstractmethod
    def setPacketTimeout(self, packet_length: int) -> None:
        """An answer of so many bytes is awaited from now on."""

    @abstractmethod
    def setPacketTimeoutMillis(self, msec: float) -> None: ...

    @abstractmethod
    def isPacketTimeout(self) -> bool:
        """Whether the answer is overdue."""
