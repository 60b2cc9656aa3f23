"""A serial line as bytes: out, back, and the time that passes on it."""

from __future__ import annotations

from abc import ABC, abstractmethod

BITS = 10
"""A byte on the line: start, eight, stop."""
FLOOD = 8192
"""Bytes after which an answer counts as overdue, whatever still comes: a stranger may never stop speaking."""
LATENCY = 0.02
"""s that an adapter and a busy computer may take beside the bytes: FTDI's adapters hold bytes for 16 ms by default."""


class SerialLine(ABC):
    """Bytes out and back, and the time that passes. Raises LinkError for whatever ends it."""

    lockstep = False
    """Whether time here passes only while somebody waits for it."""

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

    @abstractmethod
    def clear(self) -> None:
        """Forget what was received."""

    @abstractmethod
    def send(self, data: bytes) -> None: ...

    @abstractmethod
    def receive(self, most: int, seconds: float) -> bytes:
        """What has come, so many bytes at most; nothing if nothing comes within so many seconds."""
