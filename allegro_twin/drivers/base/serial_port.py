"""A real serial port, for this program alone; or a terminal at whose other end a virtual hand is. On pyserial."""

from __future__ import annotations

import fcntl
import select
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import serial

from allegro_twin.drivers.base.serial_line import SerialLine
from allegro_twin.errors import LinkError


class SerialPort(SerialLine):
    """Opens it. Raises LinkError when it is not there, or another program has it."""

    def __init__(self, path: str, baud: int) -> None:
        super().__init__(path, baud)
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
        self.clear()

    def rebaud(self, baud: int) -> None:
        with self._told(f"set {baud} baud on"):
            self._port.baudrate = baud
            self._port.reset_input_buffer()
        self.baud = baud

    def clear(self) -> None:
        with self._told("read"):
            self._port.reset_input_buffer()

    def send(self, data: bytes) -> None:
        with self._told("write to"):
            self._port.write(data)

    def receive(self, most: int, seconds: float) -> bytes:
        with self._told("read"):
            data = bytes(self._port.read(most))
            if not data and most and select.select([self._port], [], [], max(seconds, 0.0))[0]:
                data = bytes(self._port.read(most))
        return data

    def close(self) -> None:
        with suppress(OSError, termios.error):  # The adapter is gone, and so is the port.
            fcntl.flock(self._port.fileno(), fcntl.LOCK_UN)  # Others may hold this descriptor: a keeper, a child.
            self._port.close()

    @property
    def shared(self) -> int | None:
        return int(self._port.fileno())

    @contextmanager
    def _told(self, doing: str) -> Iterator[None]:
        try:
            yield
        except (OSError, termios.error, ValueError) as error:  # pyserial raises ValueError for a speed.
            raise LinkError(f"cannot {doing} {self.name}: {error}; is it plugged in, and nobody else's?") from error
