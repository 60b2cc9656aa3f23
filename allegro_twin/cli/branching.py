"""What `allegro-twin branch` does and shows, apart from the command line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

if TYPE_CHECKING:
    from allegro_twin.build.branching import Branched

_AFTER = (0.0, 0.1, 0.3, 1.0, 3.0)  # s
_SAME = "the same to the last bit"


def branched(path: Path, at: float, texts: list[str], record: Path | None) -> Branched:
    """The branch, and its recording where one is wanted. Raises HandError."""
    from allegro_twin.build.branching import branch, changes_of
    from allegro_twin.replay.recorder import Recorder
    from allegro_twin.replay.recording import load

    changes = changes_of(texts)
    with ExitStack() as stack:
        if record is None:
            return branch(path, at, changes)
        origin = load(path)
        meta = {key: value for key, value in origin.meta.items() if key in ("allegro_twin", "engine", "look")}
        meta["branch"] = {"of": path.name, "at": at, "set": changes}
        recorder = Recorder(record, origin.spec, origin.period, meta)
        stack.callback(recorder.close)
        return branch(path, at, changes, recorder.add)


def table(path: Path, found: Branched, at: float) -> Table:
    """How far apart the two futures are, finger by finger, at some moments."""
    made = Table(title=f"{path.name}: both futures from {at:g} s, largest difference of a finger's joints, mrad")
    made.add_column("after")
    spec_fingers = [range(k, k + 4) for k in range(0, found.recorded.shape[1], 4)]
    for number in range(len(spec_fingers)):
        made.add_column(f"finger {number}", justify="right")
    off = 1000.0 * np.abs(found.branched - found.recorded[: len(found.branched)])
    for after in _AFTER:
        row = int(np.searchsorted(found.t, at + after - 1e-9))
        if row < len(off):
            made.add_row(f"{after:g} s", *(f"{off[row, list(joints)].max():.3f}" for joints in spec_fingers))
    return made


def lines(found: Branched, at: float) -> Iterator[str]:
    """Whether anything changed, and what became of a grasp."""
    same = bool((found.branched == found.recorded[: len(found.branched)]).all())
    yield f"Until {at:g} s both are {_SAME}{'; and after it, too.' if same else '.'}"
    if found.report is not None:
        held = "held" if found.report.held else f"not held: {found.report.reason}"
        yield f"The grasp of the branch: {held}"
