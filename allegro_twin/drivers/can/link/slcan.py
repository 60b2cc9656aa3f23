"""Serial CAN adapters (slcan, LAWICEL's protocol): python-can's bus, but reading all that waits at once, and alone."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import select
import time
from collections import deque
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import can
from can.interfaces.slcan import slcanBus

from allegro_twin.drivers.base.keeper.keeper import LinkAddress
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.link.adapter import PortTaken

_CHUNK = 1 << 16
_NEARLY_FULL = 4000
"""Bytes that wait at which a terminal may have begun to lose some: it holds 4095 (n_tty.c N_TTY_BUF_SIZE)."""
_EMPTY = 20
"""Times in a row that a port which is ready gives nothing: once or twice, the keeper of this very hand was faster."""
_WAIT = 1.0
"""s that a port which another program is letting go of is waited for."""


class SlcanBus(slcanBus):
    """Takes python-can's arguments. Raises can.CanInitializationError that says who has the port.

    Lines that cannot be read mean that bytes were lost, and so does a nearly full buffer: an error frame says it.
    """

    def __init__(self, channel: str, **options: Any) -> None:
        self._lock = _locked(channel.split("@")[0])
        self._lines, self._rest, self._unsent, self._full = deque[bytes](), b"", b"", False
        self._empty = 0
        with ExitStack() as unless_open:
            unless_open.callback(os.close, self._lock)
            super().__init__(channel, **options)
            os.set_blocking(self.serialPortOrig.fileno(), False)
            unless_open.pop_all()

    @property
    def address(self) -> LinkAddress:
        """Another process can go on writing to the port that is open here."""
        return {"kind": "slcan", "fd": self.serialPortOrig.fileno()}

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Raises can.CanOperationError with ENOBUFS when the port takes no more."""
        if msg.is_extended_id or msg.is_fd:
            raise can.CanOperationError("a hand's frames have 11 bits")
        data = "" if msg.is_remote_frame else bytes(msg.data).hex().upper()
        self._put(f"{'r' if msg.is_remote_frame else 't'}{msg.arbitration_id:03X}{msg.dlc}{data}\r".encode())

    def shutdown(self) -> None:
        try:
            super().shutdown()
        finally:
            if self._lock >= 0:
                os.close(self._lock)
                self._lock = -1

    def _write(self, string: str) -> None:
        self._put(string.encode() + self.LINE_TERMINATOR)

    def _put(self, line: bytes) -> None:
        """A whole line or none of it."""
        try:
            if self._unsent:
                self._unsent = self._unsent[self._some(self._unsent) :]
            if self._unsent:
                raise can.CanOperationError("the serial port takes no more", errno.ENOBUFS)
            sent = self._some(line)
        except OSError as error:
            raise can.CanOperationError(f"cannot write to the serial port: {error}", error.errno) from error
        if not sent:
            raise can.CanOperationError("the serial port takes no more", errno.ENOBUFS)
        self._unsent = line[sent:]

    def _some(self, data: bytes) -> int:
        try:
            return os.write(self.serialPortOrig.fileno(), data)
        except BlockingIOError:
            return 0

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._lines:
            self._fill(timeout)
        while self._lines:
            line = self._lines.popleft()
            if not line:
                return _lost(), False
            message = _message(line)
            if message is not None:
                return message, False
        return None, False

    def _fill(self, timeout: float | None) -> None:
        """Read all that waits, after waiting for it."""
        port = self.serialPortOrig.fileno()
        try:
            if not select.select([port], [], [], timeout)[0]:
                return
            data = os.read(port, _CHUNK)
        except BlockingIOError:
            return
        except OSError as error:
            raise can.CanOperationError(f"cannot read from the serial port: {error}", error.errno) from error
        self._empty = 0 if data else self._empty + 1
        if self._empty > _EMPTY:
            raise can.CanOperationError("the serial port is gone", errno.EIO)
        *lines, self._rest = (self._rest + data).replace(b"\a", b"\r").split(b"\r")
        self._rest = self._rest[-64:]  # No line is longer: an unterminated flood is noise.
        self._lines.extend(line for line in lines if line)
        was, self._full = self._full, len(data) >= _NEARLY_FULL
        if was or self._full:
            self._lines.append(b"")  # What comes next may lack something before it.


def _message(line: bytes) -> can.Message | None:
    """A frame `tIIILDD…` or `rIIIL`; None for what is none; for a line that was cut, that something was lost."""
    kind = line[:1]
    if kind not in b"tr" or line in (b"t", b"r"):
        return None
    try:
        identifier, length = int(line[1:4], 16), int(line[4:5])
        data = bytes.fromhex(line[5 : 5 + 2 * length].decode()) if kind == b"t" else b""
        if kind == b"t" and len(data) != length:
            return _lost()
        frame = Frame(identifier, data, kind == b"r")
    except ValueError:
        return _lost()
    return can.Message(
        arbitration_id=frame.id,
        is_extended_id=False,
        is_remote_frame=frame.remote,
        data=frame.data,
        dlc=length,
        timestamp=time.time(),
    )


def _lost() -> can.Message:
    """The error frame by which SocketCAN says that the receiver lost frames (linux/can/error.h)."""
    return can.Message(arbitration_id=0x04, is_error_frame=True, data=bytes([0, 1, 0, 0, 0, 0, 0, 0]))


_FLOCK = re.compile(r"^lock:.* FLOCK .* (\d+) \S+ \S+ \S+$", re.M)
"""In the fdinfo of a descriptor: the process that locked its file."""


def _locked(path: str) -> int:
    """The port, for this program alone: a descriptor that holds a lock on it."""
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    deadline = time.monotonic() + _WAIT
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() < deadline:
                select.select([], [], [], 0.02)
                continue
            os.close(descriptor)
            raise PortTaken(
                f"{_holder(path)} has this port, which serves one program at a time: wait until it ends"
            ) from None
        return descriptor


def _holder(path: str) -> str:
    """The program of this computer that has locked a file; where that cannot be seen, `another program`. Those that
    merely have it open, such as a keeper and what serves a virtual hand, are not asked about."""
    wanted = os.path.realpath(path)
    for process in Path("/proc").glob("[0-9]*"):
        try:
            for one in (process / "fd").iterdir():
                if os.path.realpath(one) != wanted:
                    continue
                owner = _FLOCK.search((process / "fdinfo" / one.name).read_text())
                if owner is not None:
                    words = Path("/proc", owner[1], "cmdline").read_bytes().split(b"\0")
                    shown = _short([word.decode(errors="replace") for word in words if word])
                    return f"`{shown}` (pid {owner[1]})"
        except OSError:
            continue  # Gone meanwhile, or another user's.
    return "another program"


def _short(words: list[str]) -> str:
    """A command line without the interpreter and the folders."""
    shown = [os.path.basename(words[0]) if words else "?", *words[1:]]
    if shown[0].startswith("python") and len(shown) > 1:
        shown = [os.path.basename(shown[1]), *shown[2:]] if shown[1] != "-m" else shown[2:]
    return " ".join(shown)[:80]
