"""Suspend (a closed lid, an idle laptop): held off while a hand is driven where the system allows it, else noticed."""

from __future__ import annotations

import shutil
import subprocess
import time
from contextlib import suppress

from allegro_twin.errors import HandFault

JUMP = 0.05
"""s by which CLOCK_BOOTTIME, which counts a suspend, may run ahead of CLOCK_MONOTONIC, which does not."""
_COMMAND = ("systemd-inhibit", "--what=sleep:handle-lid-switch", "--who=allegro-twin", "--why=a robot hand is driven",
            "--mode=block", "cat")  # fmt: skip
"""`cat` ends with its standard input, and that with this program, however it ends."""


def asleep() -> float:
    """s for which this computer has been suspended since it was switched on; 0 where no clock says it."""
    try:
        return time.clock_gettime(time.CLOCK_BOOTTIME) - time.clock_gettime(time.CLOCK_MONOTONIC)
    except (AttributeError, OSError):
        return 0.0


class SuspendWatch:
    """Says when the computer was suspended while a hand was driven: its program slept, and its deadman as well."""

    def __init__(self) -> None:
        self._before = asleep()

    def restart(self) -> None:
        """What was before is forgotten."""
        self._before = asleep()

    def fault(self) -> HandFault | None:
        """What to say when it was."""
        slept = asleep() - self._before
        if slept < JUMP:
            return None
        return HandFault(
            f"this computer was suspended for {slept:.1f} s while it drove the hand, which pushed on meanwhile; reset "
            "to go on, and see docs/explanation/safety.md on suspend"
        )


class Inhibitor:
    """Asks logind, by `systemd-inhibit`, not to suspend while it exists. Does nothing where there
    is none, or where it refuses."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        if shutil.which(_COMMAND[0]) is not None:
            with suppress(OSError):
                self._process = subprocess.Popen(
                    _COMMAND, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                    start_new_session=True,
                )  # fmt: skip

    @property
    def holds(self) -> bool:
        """Whether the system has agreed, as far as is known: it is asked in the background."""
        return self._process is not None and self._process.poll() is None

    def close(self) -> None:
        """Let the computer sleep. Idempotent."""
        process, self._process = self._process, None
        if process is not None:
            assert process.stdin is not None
            with suppress(OSError):  # It has refused, and is gone.
                process.stdin.close()
            try:
                process.wait(1.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
