"""A guest's processes do not outlive the program that runs it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from tests.patience import wait_for
from tests.socketcan.process_group import run_group


@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_guest_and_its_processes_end_with_their_runner_however_it_is_killed(
    ending: signal.Signals, tmp_path: Path
) -> None:
    pids = tmp_path / "pids"
    guest = f"sleep 600 & echo $$ $! > {pids}.new; mv {pids}.new {pids}; wait"
    words = f"from tests.socketcan.process_group import run_group; run_group(['sh', '-c', {guest!r}])"
    with subprocess.Popen([sys.executable, "-c", words], stderr=subprocess.DEVNULL) as runner:
        wait_for(pids.exists)
        runner.send_signal(ending)
    for pid in map(int, pids.read_text().split()):
        wait_for(partial(_ended, pid))


def test_what_a_guest_prints_is_told_and_what_it_left_running_is_ended(tmp_path: Path) -> None:
    said = run_group(["sh", "-c", "sleep 600 > /dev/null 2>&1 & echo $!"])
    wait_for(partial(_ended, int(said)))
    with pytest.raises(subprocess.TimeoutExpired):
        run_group(["sleep", "600"], timeout=0.2)


def _ended(pid: int) -> bool:
    try:
        os.kill(pid, 0)
        return ") Z " in (Path("/proc") / str(pid) / "stat").read_text()
    except (ProcessLookupError, FileNotFoundError):
        return True
