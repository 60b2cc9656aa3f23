"""A serial port as a line: pyserial behind the names that the vendor's packet handler asks for."""

from __future__ import annotations

import select
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import serial

from allegro_twin.errors import LinkError
from allegro_twin.serial.dynamixel.codec.budget import BITS
from allegro_twin.serial.dynamixel.host.line import Line

FLOOD = 8192
"""Bytes after which an answer counts as overdue, whatever still comes: the SDK waits as long as a stranger speaks."""
LATENCY = 0.02
"""s that an adapter and a busy computer may take beside the bytes: FTDI's adapters hold bytes for 16 ms by default."""


class SerialLine(Line):
    """A real port, for this program alone; or a terminal at whose other end a virtual hand is."""

    def __init__(self, path: str, baud: int, latency: float = LATENCY) -> None:
        super().__init__(path, baud)
        self._latency, self._overdue, self._left = latency, 0.0, FLOOD
        with self._told("open"):
            self._port = serial.Serial(path, baud, timeout=0, write_timeout=1.0, exclusive=True)
        with suppress(OSError, ValueError, NotImplementedError):  # Not every adapter can, and a terminal cannot.
            self._port.set_low_latency_mode(True)

    def now(self) -> float:
        return time.monotonic()

    def wait(self, until: float) -> None:
        left = until - time.monotonic()
        if left > 0.0:
            threading.Event().wait(left)

    def begin(self) -> None:
        self.clearPort()

    def rebaud(self, baud: int) -> None:
        with self._told(f"set {baud} baud on"):
            self._port.baudrate = baud
            self._port.reset_input_buffer()
        self.baud = baud

    def close(self) -> None:
        with suppress(OSError, termios.error):  # The adapter is gone, and so is the port.
            self._port.close()

    @property
    def shared(self) -> int | None:
        return int(self._port.fileno())

    def clearPort(self) -> None:  # noqa: N802  # The SDK's name, as are those below.
        with self._told("read"):
            self._port.reset_input_buffer()

    def writePort(self, packet: list[int]) -> int:  # noqa: N802
        with self._told("write to"):
            return int(self._port.write(bytes(packet)))

    def readPort(self, length: int) -> bytes:  # noqa: N802
        with self._told("read"):
            data = bytes(self._port.read(min(length, self._left)))
            if (
                not data
                and self._left
                and select.select([self._port], [], [], max(self._overdue - time.monotonic(), 0.0))[0]
            ):
                data = bytes(self._port.read(min(length, self._left)))
        self._left -= len(data)
        return data

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        self._overdue, self._left = time.monotonic() + packet_length * BITS / self.baud + self._latency, FLOOD

    def setPacketTimeoutMillis(self, msec: float) -> None:  # noqa: N802
        self._overdue, self._left = time.monotonic() + 1e-3 * msec, FLOOD

    def isPacketTimeout(self) -> bool:  # noqa: N802
        return self._left <= 0 or time.monotonic() > self._overdue

    @contextmanager
    def _told(self, doing: str) -> Iterator[None]:
        try:
            yield
        except (OSError, termios.error, ValueError) as error:  # pyserial raises ValueError for a speed.
            raise LinkError(f"cannot {doing} {self.name}: {error}; is it plugged in, and nobody else's?") from error
