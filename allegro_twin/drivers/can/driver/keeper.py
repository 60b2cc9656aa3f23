"""The program's side of its keeper: a process of its own that leaves the hand limp, whatever becomes of the program."""

from __future__ import annotations

import json
import mmap
import os
import socket
import subprocess
import sys
import time
from collections.abc import Collection, Sequence
from contextlib import suppress
from pathlib import Path

from allegro_twin.drivers.can.codec.codec import ServoAnswer
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.driver.keeper_process import ARMED, BEAT, CUTS, HUSH, PATIENCE, SAID, SPEAK, VOICE
from allegro_twin.drivers.can.driver.link import Way
from allegro_twin.errors import LinkError

_CELLS = 8
_PROGRAM = "import sys; sys.path.append(sys.argv[1]); from keeper_process.watch import main; main()"
"""The keeper is a package of its own there, or it would load ours, and NumPy with it."""
_START = 5.0
"""s that it may take to start on a busy computer; 0.03 s on an idle one."""


class Keeper:
    """Starts it and feeds it. Armed, it cuts the hand off when `feed` was not called for `patience` seconds (None: for
    ever), and when this program ends, however it ends. Raises LinkError when it does not start."""

    def __init__(
        self,
        way: Way,
        limp: Sequence[Frame],
        reports: Collection[int],
        answer: ServoAnswer | None,
        patience: float | None,
    ) -> None:
        memory = os.memfd_create("allegro_twin")
        os.ftruncate(memory, 8 * _CELLS)
        self._cells = memoryview(mmap.mmap(memory, 8 * _CELLS)).cast("Q")
        self._cells[PATIENCE] = round(1e9 * (patience or 0.0))
        orders = {
            "program": os.getpid(),
            "memory": memory,
            "way": way,
            "limp": [(frame.id, frame.data.hex(), frame.remote) for frame in limp],
            "reports": sorted(reports),
            "ask": None if answer is None else (answer.ask.id, answer.byte, answer.mask),
        }
        self._seen = 0
        try:
            self._line, self.process = _started(orders, [memory, *([way["fd"]] if "fd" in way else [])])
        finally:
            os.close(memory)

    @property
    def cut(self) -> bool:
        """Whether it has cut the hand off since it was armed."""
        return self._cells[CUTS] != self._seen

    @property
    def confirmed(self) -> bool:
        """Whether the hand has confirmed the last cut."""
        return self._cells[SAID] == self._cells[CUTS]

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

    def take_over(self) -> None:
        """Say what leaves the hand limp until the hand confirms it, whether this program lives or not."""
        self._cells[VOICE] = SPEAK
        self._wake()

    def close(self) -> None:
        """Let it go: it ends when the hand is limp, at once where it is disarmed."""
        self._line.close()

    def hush(self) -> None:
        """Silence it for good, for this program speaks to the hand itself again."""
        self._cells[ARMED], self._cells[VOICE] = 0, HUSH
        self._line.close()

    def _wake(self) -> None:
        with suppress(OSError):
            self._line.send(b".")


def _started(orders: dict[str, object], descriptors: list[int]) -> tuple[socket.socket, int]:
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
