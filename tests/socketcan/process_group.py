"""A program with all its processes, which end with whoever runs it, however that one ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress

_KEEPER = """
import os, signal, subprocess, sys, threading
def end(): os.killpg(0, signal.SIGKILL)
def keep(): os.read(int(sys.argv[1]), 1); end()
threading.Thread(target=keep, daemon=True).start()
subprocess.run(sys.argv[2:])
end()
"""
"""The first process of the group: it runs the program, and ends all when that ends, or a pipe that only the one who
runs it holds open: the kernel closes it with that process, also where it is killed."""


def run_group(command: Sequence[str], env: Mapping[str, str] | None = None, timeout: float | None = None) -> str:
    """What a program prints. All its processes end with it, and with this one. Raises subprocess.TimeoutExpired."""
    heard, held = os.pipe()
    try:
        with subprocess.Popen(
            [sys.executable, "-c", _KEEPER, str(heard), *command], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, errors="replace", env=env, pass_fds=(heard,), start_new_session=True,
        ) as keeper:  # fmt: skip
            try:
                return keeper.communicate(timeout=timeout)[0]
            finally:
                with suppress(ProcessLookupError):  # All of it has ended.
                    os.killpg(keeper.pid, signal.SIGKILL)
    finally:
        os.close(held)
        os.close(heard)
