"""A pseudo-terminal: what a program that drives a hand opens in place of a serial adapter."""

from __future__ import annotations

import errno
import fcntl
import os
import select
import struct
import termios
import tty
from contextlib import suppress
from pathlib import Path

from allegro_twin.errors import LinkError

_SPEEDS = {getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()}
_LOCK = "hhlli4x"
"""Linux's `struct flock`: type, whence, start, length, pid."""
_INPUT = 4
"""Where tcgetattr has the speed."""


def link_terminal(path: Path, slave: int) -> None:
    """Make `path` a link to a terminal that this program serves. The link of a program that was killed is replaced.
    Raises LinkError for one that another program serves, and for a link to anything else; OSError."""
    name = os.ttyname(slave)
    with suppress(OSError):  # Not every system locks terminals: there the second program takes the link.
        fcntl.lockf(slave, fcntl.LOCK_EX | fcntl.LOCK_NB)
    if path.is_symlink():
        there = str(path.readlink())
        if not there.startswith(f"{os.path.dirname(name)}/"):
            raise LinkError(f"{path} is a link of yours to {there}: remove it, or give another place for the terminal")
        if (server := _server(there)) and server != os.getpid():
            raise LinkError(f"{path} is served by another program (pid {server}): end it, or give another place for "
                            "the terminal")  # fmt: skip
        path.unlink()
    path.symlink_to(name)


def unlink_terminal(path: Path, slave: int) -> None:
    """Remove the link, unless another program has put its own in the place."""
    with suppress(OSError):
        if str(path.readlink()) == os.ttyname(slave):
            path.unlink()


def _server(name: str) -> int:
    """The process that serves a terminal: that holds a record lock on it. 0: nobody."""
    try:
        looked_at = os.open(name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError:
        return 0
    try:
        asked = struct.pack(_LOCK, fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)
        kind, _, _, _, owner = struct.unpack(_LOCK, fcntl.fcntl(looked_at, fcntl.F_GETLK, asked))
        return int(owner) if kind != fcntl.F_UNLCK else 0
    except (OSError, struct.error):
        return 0
    finally:
        os.close(looked_at)


class Terminal:
    """The hand's end. `path` becomes a link to the other. Raises LinkError when a terminal cannot be made."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._master, self._slave = os.openpty()
            tty.setraw(self._slave)
            link_terminal(path, self._slave)
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
        unlink_terminal(self.path, self._slave)
        os.close(self._master)
        os.close(self._slave)
