"""The program's side of its keeper: a process of its own that leaves the hand limp, whatever becomes of the program."""

from __future__ import annotations

import json
import mmap
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Collection, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, TypeAlias

from allegro_twin.drivers.base.keeper.process import ARMED, BEAT, CUTS, HUSH, OWED, PATIENCE, SPEAK, VOICE
from allegro_twin.errors import LinkError

LinkAddress: TypeAlias = dict[str, Any]
"""How another process reaches the same hand: `kind` and what it takes; see `process.links`."""
_CELLS = 8
_PROGRAM = "import sys; sys.path.append(sys.argv[1]); from process.watch import main; main()"
"""The keeper is a package of its own there, or it would load ours, and NumPy with it."""
_START, _END, _HUSHED = 5.0, 2.0, 0.2
"""s that it may take to start on a busy computer, 0.03 s on an idle one; to say its last words; and to fall silent
while it says them. The last as well for its second to take its place."""


class Keeper:
    """Starts it and feeds it. Armed, it cuts the hand off when `feed` was not called for `patience` seconds (None: for
    ever), and when this program ends, however it ends. Raises LinkError when it does not start.

    `limp`: the frames that leave the hand limp, as identifier, data and whether remote; `reports`: identifiers of what
    the hand sends by itself; `ask`: how it is asked whether its motors are on. A way of bytes has none of them.
    """

    def __init__(
        self,
        address: LinkAddress,
        limp: Sequence[tuple[int, bytes, bool]] = (),
        reports: Collection[int] = (),
        ask: tuple[int, int, int] | None = None,
        patience: float | None = None,
    ) -> None:
        memory = _memory()
        os.ftruncate(memory, 8 * _CELLS)
        self._cells = memoryview(mmap.mmap(memory, 8 * _CELLS)).cast("Q")
        self._cells[PATIENCE] = round(1e9 * (patience or 0.0))
        orders = {
            "program": os.getpid(),
            "memory": memory,
            "address": address,
            "limp": [(identifier, data.hex(), remote) for identifier, data, remote in limp],
            "reports": sorted(reports),
            "ask": ask,
        }
        self._seen = 0
        try:
            self._line, self.process = _start(orders, [memory, *([address["fd"]] if "fd" in address else [])])
        finally:
            os.close(memory)

    @property
    def cut(self) -> bool:
        """Whether it has cut the hand off since it was armed."""
        return self._cells[CUTS] != self._seen

    @property
    def speaking(self) -> bool:
        """Whether it has taken over."""
        return self._cells[VOICE] == SPEAK

    @property
    def alive(self) -> bool:
        """Whether it is there."""
        try:
            return self._line.recv(1, socket.MSG_PEEK) != b""
        except BlockingIOError:
            return True
        except OSError:
            return False

    def arm(self) -> None:
        """From now on the motors may be on."""
        self._seen = self._cells[CUTS]
        self.feed()
        self._cells[ARMED] = 1
        self._wake()

    def feed(self) -> None:
        self._cells[BEAT] = time.monotonic_ns()

    def disarm(self) -> None:
        """The hand is limp."""
        self._cells[ARMED] = 0

    def take_over(self, *, wait: bool = False) -> None:
        """Say what leaves the hand limp until the hand confirms it, whether this program lives or not. `wait`: until it
        has gone, for a line that nobody else may use before."""
        self._cells[VOICE] = SPEAK
        self._wake()
        if wait:
            with suppress(OSError):
                self._line.shutdown(socket.SHUT_WR)
                self._line.settimeout(_END)
                self._line.recv(1)
            self._line.close()

    def close(self) -> None:
        """Let it go: it ends when the hand is limp, at once where it is disarmed."""
        self._line.close()

    def dismiss(self) -> None:
        """Silence it for good: the hand is limp, or this program speaks to it itself again. Where it has ended, its
        second first says its words to the end: silenced sooner and with this program ended, nobody would say them."""
        if not self.alive:
            self._await(ARMED, _HUSHED)
            self._await(OWED, _END)
        self._cells[ARMED], self._cells[VOICE] = 0, HUSH
        self._await(OWED, _HUSHED)
        self._line.close()

    def _await(self, cell: int, patience: float) -> None:
        """Until a cell is 0, so many seconds at most."""
        deadline = time.monotonic() + patience
        while self._cells[cell] and time.monotonic() < deadline:
            threading.Event().wait(0.002)

    def _wake(self) -> None:
        with suppress(OSError):
            self._line.send(b".")


def _memory() -> int:
    """A descriptor of memory to share."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("allegro_twin")
    with TemporaryFile() as file:
        return os.dup(file.fileno())


def _start(orders: dict[str, object], descriptors: list[int]) -> tuple[socket.socket, int]:
    """Start the process; the line to it, and its id. Isolated, it does not load what the environment adds to Python."""
    mine, its = socket.socketpair()
    mine.settimeout(_START)
    command = [sys.executable, "-I", "-S", "-c", _PROGRAM, str(Path(__file__).parent)]
    try:
        with its:
            process = subprocess.Popen(
                command, stdin=its.fileno(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,  # It outlives ours.
                pass_fds=descriptors, start_new_session=True,
            )  # fmt: skip
        mine.sendall(json.dumps(orders).encode() + b"\n")
        answer = mine.recv(4096)
        process.wait(_START)
    except (OSError, subprocess.SubprocessError) as error:
        mine.close()
        raise LinkError(f"no keeper for this hand: {error}; `keeper: false` does without") from error
    mine.setblocking(False)
    if not answer.startswith(b"ready"):
        mine.close()
        why = answer.decode(errors="replace").removeprefix("no: ") or "it ended at once"
        raise LinkError(f"no keeper for this hand: {why}; `keeper: false` does without")
    return mine, int(answer.split()[1])
