"""The adapter's side of slcan (LAWICEL's serial protocol) on a pseudo-terminal: a serial CAN adapter that is not there.

Each line ends with a carriage return: `tIIILDD…` is a frame, `rIIIL` a remote frame; `Sn` sets the bitrate, `O` opens,
`C` closes, `V`, `v`, `N` and `F` ask. What is refused is answered with a bell.
"""

from __future__ import annotations

import errno
import os
import select
import termios
import tty
from collections import deque
from pathlib import Path
from typing import Any

import can

from allegro_twin.errors import LinkError

BITRATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
"""S0 … S8. LAWICEL CAN232 manual."""
_ANSWERS = {"V": b"V1013\r", "v": b"v1013\r", "N": b"NALLE\r", "F": b"F00\r"}
_OK, _REFUSED = b"\r", b"\a"


class SlcanDevice(can.BusABC):
    """What a driver opens is `path`: a link to the pseudo-terminal. Raises LinkError when it cannot be made."""

    def __init__(self, path: Path, bitrate: int = 1_000_000) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self._slave = slave  # Kept open, or the master would see an end whenever no driver is there.
        self._path, self._bitrate = path, bitrate
        self._buffer, self._queue = bytearray(), deque[can.Message]()
        self._listening, self._pending = False, b""
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.is_symlink():
                path.unlink()
            path.symlink_to(os.ttyname(slave))
        except OSError as error:
            raise LinkError(f"cannot put a terminal at {path}: {error}") from error
        os.set_blocking(self._master, False)
        self.channel_info = f"slcan device {path}"
        super().__init__(str(path))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Dropped when no driver has opened the channel, or when it does not read: as on a bus."""
        if not self._listening:
            return
        kind = "r" if msg.is_remote_frame else "t"
        data = "" if msg.is_remote_frame else bytes(msg.data).hex().upper()
        self._write(f"{kind}{msg.arbitration_id:03X}{msg.dlc}{data}\r".encode())

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._queue and select.select([self._master], [], [], timeout)[0]:
            self._read()
        return (self._queue.popleft() if self._queue else None), False

    def shutdown(self) -> None:
        super().shutdown()
        self._path.unlink(missing_ok=True)
        os.close(self._master)
        os.close(self._slave)

    def _read(self) -> None:
        try:
            self._buffer += os.read(self._master, 4096)
        except BlockingIOError:
            return
        *lines, rest = self._buffer.split(b"\r")
        self._buffer = bytearray(rest[-64:])  # No line is longer: an unterminated flood is noise.
        for line in lines:
            self._obey(line.decode("ascii", "replace").strip("\n\a"))

    def _obey(self, line: str) -> None:
        command, rest = line[:1], line[1:]
        if command in ("t", "r") and self._listening:
            message = _frame(rest, remote=command == "r")
            self._write(_REFUSED if message is None else b"z\r")
            if message is not None:
                self._queue.append(message)
        elif command == "S" and rest.isdigit() and int(rest) < len(BITRATES):
            self._write(_OK if BITRATES[int(rest)] == self._bitrate else _REFUSED)
        elif command in ("O", "L", "C"):
            self._listening = command != "C"
            self._pending = b""
            termios.tcflush(self._slave, termios.TCIFLUSH)  # What a driver that died never read.
            self._write(_OK)
        elif command in _ANSWERS:
            self._write(_ANSWERS[command])
        elif command:
            self._write(_OK if command in ("s", "Z", "M", "m", "Y", "X") else _REFUSED)

    def _write(self, line: bytes) -> None:
        """A whole line or none of it, for a driver that does not read in time."""
        try:
            if self._pending:
                self._pending = self._pending[os.write(self._master, self._pending) :]
            if not self._pending:
                self._pending = line[os.write(self._master, line) :]
        except BlockingIOError:
            pass  # A bus forgets too.
        except OSError as error:
            if error.errno != errno.EIO:  # The driver is gone; the next one may come.
                raise can.CanOperationError(str(error)) from error


def _frame(text: str, *, remote: bool) -> can.Message | None:
    """`IIILDD…`, or None for what is none."""
    try:
        identifier, length = int(text[:3], 16), int(text[3:4])
        data = b"" if remote else bytes.fromhex(text[4 : 4 + 2 * length])
    except ValueError:
        return None
    if length > 8 or identifier > 0x7FF or (not remote and len(data) != length):
        return None
    arguments: dict[str, Any] = {"dlc": length} if remote else {"data": data}
    return can.Message(arbitration_id=identifier, is_extended_id=False, is_remote_frame=remote, **arguments)
