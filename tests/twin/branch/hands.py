"""Recordings as those of a hand that nobody simulates, and how far two futures are apart."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.recording.reader import load
from allegro_twin.recording.recorder import record
from allegro_twin.twin.branch.result import BranchResult
from allegro_twin.twin.mirror.on_recording import recorded_samples
from allegro_twin.types import Array

AT = 1.1  # s. The fingers are on their way home.
MRAD = 1e-3


def as_real(path: Path, target: Path, left_out: slice = slice(0, 0), **meta: Any) -> Path:
    """The same recording as one of a hand that nobody simulates, but for some rows; None takes an entry away."""
    origin = load(path)
    kept = {key: value for key, value in {**origin.meta, **meta}.items() if value is not None and key != "engine"}
    rows = list(recorded_samples(origin))
    del rows[left_out]
    for _ in record(iter(rows), target, origin.spec, origin.period, meta=kept):
        pass
    return target


def rms(off: Array) -> float:
    return float(np.sqrt(np.square(off).mean()))


def after(found: BranchResult) -> slice:
    return slice(int(np.searchsorted(found.t, AT - 1e-9)), len(found.branched))
