"""Ask the kernel to run this program before others, so that no period is missed on a busy machine."""

from __future__ import annotations

import os

from allegro_twin.errors import ConfigError

PRIORITY = 20
"""Of SCHED_FIFO, 1 … 99: above every ordinary program, below the kernel's own threads (50)."""


def ask() -> None:
    """From now on this thread, and those it starts, go first. Raises ConfigError where the kernel does not allow it."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError) as error:
        raise ConfigError(
            f"no real-time scheduling here ({error}); allow it (`ulimit -r {PRIORITY}`, CAP_SYS_NICE) or set "
            "`realtime: false`"
        ) from error
