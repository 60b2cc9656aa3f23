"""Scheduling of the program that drives a hand, so that a busy computer misses few periods, or none."""

from __future__ import annotations

import ctypes
import logging
import os
import platform
import struct
from typing import Literal

from allegro_twin.errors import ConfigError

log = logging.getLogger(__name__)

PRIORITY = 20
"""Priority in SCHED_FIFO, 1 … 99: above every ordinary program, below the kernel's own threads (50)."""

SLICE = 100_000
"""ns that this program wants to run at a stretch: the shortest that the kernel grants (sched(7), since Linux 6.12). A
period's work takes little more, and who asks for little waits less for its turn. Needs no permission."""
_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}
"""Numbers of the system call (arch/x86/entry/syscalls/syscall_64.tbl; include/uapi/asm-generic/unistd.h)."""


def ask_short_slice() -> bool:
    """Wait less for a core than others do; whether the kernel takes it. An ordinary program keeps its niceness."""
    number = _SCHED_SETATTR.get(platform.machine())
    if number is None or platform.system() != "Linux" or os.sched_getscheduler(0) != os.SCHED_OTHER:
        return False
    # struct sched_attr: size, policy, flags, nice, priority, runtime, deadline, period (linux/sched/types.h).
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    wanted = struct.pack("=IIQiIQQQ", 48, os.SCHED_OTHER, 0, nice, 0, SLICE, 0, 0)
    return bool(ctypes.CDLL(None).syscall(number, 0, wanted, 0) == 0)


def ask(wanted: bool | Literal["try"]) -> None:
    """From now on this thread, and those it starts, go first; unless that is wanted they only wait less. Where the
    kernel does not allow it, ConfigError, or a warning for `try`."""
    if not wanted:
        ask_short_slice()
        return
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError) as error:
        why = f"no real-time scheduling here ({error}); allow it with `ulimit -r {PRIORITY}` or CAP_SYS_NICE"
        if wanted == "try":
            log.warning("%s: a busy computer will miss periods", why)
            return
        raise ConfigError(f"{why}, or set `realtime: false`") from error
