"""A pseudo-terminal: what a program that drives a hand opens in place of a serial adapter."""

from __future__ import annotations

import errno
import os
import select
import termios
import tty
from pathlib import Path

from allegro_twin.errors import LinkError

_SPEEDS = {getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()}
_INPUT = 4
"""Where tcgetattr has the speed."""


class Terminal:
    """The hand's end. `path` becomes a link to the other. Raises LinkError when a terminal cannot be made."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._master, self._slave = os.openpty()
            tty.setraw(self._slave)
            if path.is_symlink():
                path.unlink()
            path.symlink_to(os.ttyname(self._slave))
        except OSError as error:
            raise LinkError(f"cannot put a terminal at {path}: {error}") from error
        os.set_blocking(self._master, False)

    @property
    def baud(self) -> int:
        """What the driver set, bit/s; 0 for a speed that has no name."""
        return _SPEEDS.get(termios.tcgetattr(self._slave)[_INPUT], 0)

    def read(self, timeout: float) -> bytes:
        """What came, or nothing after `timeout` seconds."""
        if not select.select([self._master], [], [], max(timeout, 0.0))[0]:
            return b""
        try:
            return os.read(self._master, 4096)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> bool:
        """False when nobody reads and they were lost, as on a wire."""
        try:
            return os.write(self._master, data) == len(data)
        except BlockingIOError:
            return False
        except OSError as error:
            if error.errno != errno.EIO:  # The driver is gone; the next one may come.
                raise LinkError(f"cannot answer on {self.path}: {error}") from error
            return False

    def close(self) -> None:
        self.path.unlink(missing_ok=True)
        os.close(self._master)
        os.close(self._slave)
