"""Processor count available to this program, as bound by `taskset` or a job scheduler."""

from __future__ import annotations

import os


def core_count() -> int:
    """How many processes or threads can run at once here."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
