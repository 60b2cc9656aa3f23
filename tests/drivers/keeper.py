"""The orders in which a program that drives a hand, its keeper and the keeper's second are ended."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from tests.patience import comes_true

DEATHS = {
    "keeper, then program": (("keeper", signal.SIGKILL), ("program", signal.SIGKILL)),
    "program, then keeper": (("program", signal.SIGKILL), ("keeper", signal.SIGKILL)),
    "keeper stands still, then program": (("keeper", signal.SIGSTOP), ("program", signal.SIGKILL)),
    "second, then program": (("second", signal.SIGKILL), ("program", signal.SIGKILL)),
    "keeper, then program stands still": (("keeper", signal.SIGKILL), ("program", signal.SIGSTOP)),
}
ALL_THREE = (
    ("keeper", signal.SIGSTOP), ("second", signal.SIGKILL), ("keeper", signal.SIGKILL), ("program", signal.SIGKILL),
)  # fmt: skip
"""What no keeper outlives: it makes no second while it stands still."""


def second_of(keeper: int) -> int:
    """The process that stands by for a keeper."""
    children: list[str] = []

    def found() -> bool:
        children[:] = Path(f"/proc/{keeper}/task/{keeper}/children").read_text().split()
        return bool(children)

    assert comes_true(found)
    return int(children[0])


def end(
    order: tuple[tuple[str, signal.Signals], ...], program: subprocess.Popen[str], keeper: int, between: float
) -> Callable[[], None]:
    """End them in this order, so many seconds apart; the result ends what only stands still."""
    process = {"keeper": keeper, "program": program.pid, "second": second_of(keeper)}
    for who, number in order:
        os.kill(process[who], number)
        time.sleep(between)

    def finish() -> None:
        for who, number in order:
            if number == signal.SIGSTOP and (who, signal.SIGKILL) not in order:
                os.kill(process[who], signal.SIGKILL)

    return finish
