"""Waiting for a condition with a patience that is measured in work, not in seconds of a wall clock.

A deadline in seconds says how busy the computer is. Here each turn of waiting costs the waiter a fixed piece of work,
so that a computer which gives a process one tenth of a core gives it ten times as long, in a guest of user-mode Linux
too, whose clock of CPU time does not notice what its host takes away.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable

_WORK = 50_000
"""Turns of an empty loop: about 2 ms of a core."""
_REST = 0.008
"""Seconds that a turn sleeps, so that the one who is waited for has the core meanwhile."""
_TURN = 0.01


def comes_true(condition: Callable[[], object], seconds: float = 20.0) -> bool:
    """Whether `condition` comes true within what are about `seconds` on an idle computer, and more on a busy one."""
    for _ in range(max(1, round(seconds / _TURN))):
        if condition():
            return True
        time.sleep(_REST)
        for _ in range(_WORK):
            pass
    return bool(condition())


def wait_for(condition: Callable[[], object], what: str = "what was waited for", seconds: float = 20.0) -> None:
    """As comes_true; raises AssertionError with `what` where it did not."""
    assert comes_true(condition, seconds), f"{what} did not come about"


def exit_code(process: subprocess.Popen[str] | subprocess.Popen[bytes], seconds: float = 60.0) -> int:
    """The exit code of a process that ends by itself, or that is killed when patience ends (AssertionError)."""
    if not comes_true(lambda: process.poll() is not None, seconds):
        process.kill()
        process.wait()
        raise AssertionError(f"the process {process.args!r} did not end")
    return process.wait()
