"""A process that says the last words on a serial line when the program that drives a hand dies, however it dies.

Run as a script, by its path, so that it loads nothing of this package: `keeper.py FD HEX`.
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
from contextlib import suppress

DISMISSED = b"q"
_TIMES, _BETWEEN = 25, 0.02
"""How often the last words are said, and s between two: whatever half packet the dead left behind is over by then."""
_GLANCE = 0.05
"""s between two looks whether the program still is there: a child that it forked would hold our pipe open."""


class Keeper:
    """Starts it. `words` are bytes that leave the hand limp; `line` a file descriptor of the port."""

    def __init__(self, line: int, words: bytes) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", __file__, str(line), words.hex(), str(os.getpid())],
            stdin=subprocess.PIPE,
            bufsize=0,
            pass_fds=(line,),
            start_new_session=True,  # Ctrl-C is for the program.
        )

    @property
    def process(self) -> int:
        """Its process."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    def dismiss(self) -> None:
        """The hand is limp: it may go without a word."""
        self._end(DISMISSED)

    def speak(self) -> None:
        """Nobody knows whether the hand is limp: it says its words, and goes."""
        self._end(b"")

    def _end(self, word: bytes) -> None:
        pipe = self._process.stdin
        assert pipe is not None
        with suppress(OSError):  # Somebody ended it.
            pipe.write(word)
        pipe.close()
        self._process.wait()


def keep(line: int, words: bytes, parent: int) -> None:
    """Wait for the end of the program, and say the words unless dismissed."""
    while True:
        if select.select([0], [], [], _GLANCE)[0]:
            if os.read(0, 1) == DISMISSED:
                return
            break
        if os.getppid() != parent:
            break
    for _ in range(_TIMES):
        with suppress(OSError):  # The port is gone, and with it the way to say it.
            os.write(line, words)
        select.select([], [], [], _BETWEEN)


if __name__ == "__main__":
    keep(int(sys.argv[1]), bytes.fromhex(sys.argv[2]), int(sys.argv[3]))
