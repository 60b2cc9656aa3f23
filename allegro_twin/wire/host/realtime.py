"""Ask the kernel to run this program before others, so that no period is missed on a busy machine."""

from __future__ import annotations

import logging
import os
from typing import Literal

from allegro_twin.errors import ConfigError

log = logging.getLogger(__name__)

PRIORITY = 20
"""Of SCHED_FIFO, 1 … 99: above every ordinary program, below the kernel's own threads (50)."""


def ask(wanted: bool | Literal["try"]) -> None:
    """From now on this thread, and those it starts, go first. Where the kernel does not allow it, ConfigError, or a
    warning for `try`."""
    if not wanted:
        return
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError) as error:
        why = f"no real-time scheduling here ({error}); allow it with `ulimit -r {PRIORITY}` or CAP_SYS_NICE"
        if wanted == "try":
            log.warning("%s: a busy computer will miss periods", why)
            return
        raise ConfigError(f"{why}, or set `realtime: false`") from error
