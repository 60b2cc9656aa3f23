"""Serial CAN adapters that do not exist (slcan, LAWICEL's protocol), on pseudo-terminals: one for a driver, one to tap.

Each line ends with a carriage return: `tIIILDD…` is a frame, `rIIIL` a remote frame; `Sn` sets the bitrate, `O` opens,
`C` closes, `V`, `v`, `N` and `F` ask. What is refused is answered with a bell.
"""

from __future__ import annotations

import errno
import os
import re
import select
import termios
import tty
from collections import deque
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import can

from allegro_twin.drivers.base.terminal import link_terminal, unlink_terminal
from allegro_twin.errors import LinkError

BITRATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
"""S0 … S8. LAWICEL CAN232 manual."""
TAP = ".tap"
"""What is added to the name of the driver's port for that of the port to listen at."""
_ANSWERS = {"V": b"V1013\r", "v": b"v1013\r", "N": b"NALLE\r", "F": b"F00\r"}
_OK, _REFUSED = b"\r", b"\a"
_LINE = re.compile(r"([0-7][0-9A-Fa-f]{2})([0-8])((?:[0-9A-Fa-f]{2})*)")


class SlcanDevice(can.BusABC):
    """The bus at whose other end such adapters are. What a driver opens is `path`: a link to the pseudo-terminal.

    Each adapter hears the hand and the other. Raises LinkError when a terminal cannot be made.
    """

    def __init__(self, path: Path, bitrate: int = 1_000_000) -> None:
        self._queue: deque[can.Message] = deque()
        self._adapters: dict[int, SlcanAdapter] = {}
        with ExitStack() as made:
            for name in (path, path.with_name(path.name + TAP)):
                adapter = SlcanAdapter(name, bitrate)
                made.callback(adapter.close)
                self._adapters[adapter.master] = adapter
            made.pop_all()
        self.channel_info = f"slcan device {path}"
        super().__init__(str(path))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Dropped where no program has opened the channel, or where it does not read: as on a bus."""
        for adapter in self._adapters.values():
            adapter.tell(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._queue:
            for master in select.select(list(self._adapters), [], [], timeout)[0]:
                for message in self._adapters[master].heard():
                    self._queue.append(message)
                    for other, adapter in self._adapters.items():
                        if other != master:
                            adapter.tell(message)
        return (self._queue.popleft() if self._queue else None), False

    def shutdown(self) -> None:
        super().shutdown()
        for adapter in self._adapters.values():
            adapter.close()


class SlcanAdapter:
    """One of them: what it is told on its serial line it says on the bus, once its channel is open."""

    def __init__(self, path: Path, bitrate: int) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        self._slave = slave  # Kept open, or the master would see an end whenever no driver is there.
        self._path, self._bitrate = path, bitrate
        self._buffer, self._listening, self._pending = bytearray(), False, b""
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            link_terminal(path, slave)
        except OSError as error:
            raise LinkError(f"cannot put a terminal at {path}: {error}") from error
        os.set_blocking(self.master, False)

    def tell(self, message: can.Message) -> None:
        """A frame that is on the bus."""
        if self._listening:
            kind = "r" if message.is_remote_frame else "t"
            data = "" if message.is_remote_frame else bytes(message.data).hex().upper()
            self._write(f"{kind}{message.arbitration_id:03X}{message.dlc}{data}\r".encode())

    def heard(self) -> list[can.Message]:
        """The frames that its driver puts on the bus."""
        try:
            self._buffer += os.read(self.master, 4096)
        except BlockingIOError:
            return []
        *lines, rest = self._buffer.split(b"\r")
        self._buffer = bytearray(rest[-64:])  # No line is longer: an unterminated flood is noise.
        said = (self._obey(line.decode("ascii", "replace").strip("\n\a")) for line in lines)
        return [message for message in said if message is not None]

    def close(self) -> None:
        unlink_terminal(self._path, self._slave)
        os.close(self.master)
        os.close(self._slave)

    def _obey(self, line: str) -> can.Message | None:
        command, rest = line[:1], line[1:]
        if command in ("t", "r") and self._listening:
            message = _frame(rest, remote=command == "r")
            self._write(_REFUSED if message is None else b"z\r")
            return message
        if command == "S" and rest.isdigit() and int(rest) < len(BITRATES):
            self._write(_OK if BITRATES[int(rest)] == self._bitrate else _REFUSED)
        elif command in ("O", "L", "C"):
            self._listening = command != "C"
            self._pending = b""
            with suppress(termios.error):  # The kernel's own slcan, when it is at the other end, keeps nothing.
                termios.tcflush(self._slave, termios.TCIFLUSH)  # What a driver that died never read.
            self._write(_OK)
        elif command in _ANSWERS:
            self._write(_ANSWERS[command])
        elif command:
            self._write(_OK if command in ("s", "Z", "M", "m", "Y", "X") else _REFUSED)
        return None

    def _write(self, line: bytes) -> None:
        """A whole line or none of it, for a driver that does not read in time."""
        try:
            if self._pending:
                self._pending = self._pending[os.write(self.master, self._pending) :]
            if not self._pending:
                self._pending = line[os.write(self.master, line) :]
        except BlockingIOError:
            pass  # A bus forgets too.
        except OSError as error:
            if error.errno != errno.EIO:  # The driver is gone; the next one may come.
                raise can.CanOperationError(str(error)) from error


def _frame(text: str, *, remote: bool) -> can.Message | None:
    """`IIILDD…`, or None for what is none."""
    if (read := _LINE.fullmatch(text)) is None:
        return None
    identifier, length, data = int(read[1], 16), int(read[2]), bytes.fromhex(read[3])
    if len(data) != (0 if remote else length):
        return None
    arguments: dict[str, Any] = {"dlc": length} if remote else {"data": data}
    return can.Message(arbitration_id=identifier, is_extended_id=False, is_remote_frame=remote, **arguments)
