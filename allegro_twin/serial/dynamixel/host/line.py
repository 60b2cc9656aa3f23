"""The line to a hand of servos: what the vendor's packet handler speaks through, and the time that passes on it."""

from __future__ import annotations

from abc import ABC, abstractmethod

# The SDK's packet handler asks for these names.
# ruff: noqa: N802


class Line(ABC):
    """A port as `dynamixel_sdk` wants one, with a clock. Raises LinkError for whatever ends it."""

    lockstep = False
    """Whether time on this line passes only while somebody waits for it."""
    is_using = False
    """The packet handler's own mark that an answer is awaited."""

    def __init__(self, name: str, baud: int) -> None:
        self.name, self.baud = name, baud

    @abstractmethod
    def now(self) -> float:
        """Seconds on a clock that never goes back, but for `begin` on a lockstep line."""

    @abstractmethod
    def wait(self, until: float) -> None:
        """Let time pass until then."""

    @abstractmethod
    def begin(self) -> None:
        """A session begins: what exists only here starts anew."""

    @abstractmethod
    def rebaud(self, baud: int) -> None:
        """Speak at another speed from now on."""

    @abstractmethod
    def close(self) -> None:
        """Let go of it. Idempotent; never raises."""

    @property
    def shared(self) -> int | None:
        """A file descriptor through which another process can speak on it; None where none can."""
        return None

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
