"""How many processors this program may use: those that it is bound to, as by `taskset` or a scheduler of jobs."""

from __future__ import annotations

import os


def core_count() -> int:
    """How many processes or threads can run at once here."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
