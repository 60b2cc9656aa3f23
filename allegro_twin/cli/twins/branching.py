"""What `allegro-twin branch` does and shows, apart from the command line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

from allegro_twin.files.whole import whole_file

if TYPE_CHECKING:
    from allegro_twin.build.branching import Beside, Branched
    from allegro_twin.types import Sample

_AFTER = (0.0, 0.1, 0.3, 1.0, 3.0)  # s
_SAME = "the same to the last bit"


def branched(path: Path, at: float, texts: list[str], record: Path | None, rrd: Path | None) -> Branched:
    """The branch, recorded and drawn where that is wanted, with where the recording's joints were as `target`. Raises
    HandError."""
    from allegro_twin.build.branching import branch, changes_of
    from allegro_twin.replay.recorder import recorded
    from allegro_twin.replay.recording import load
    from allegro_twin.session import rerun_stage

    changes, origin = changes_of(texts), load(path)
    with ExitStack() as stack:

        def through(samples: Iterator[Sample], beside: Beside) -> Iterator[Sample]:
            if record is not None:
                meta = {k: value for k, value in origin.meta.items() if k in ("allegro_twin", "engine", "look")}
                meta["branch"] = {"of": path.name, "at": at, "set": changes}
                samples = recorded(samples, record, origin.spec, origin.period, meta=meta, extras=beside)
            if rrd is not None:
                viewer_of, shown = rerun_stage()
                from allegro_twin.look.scenery import scenery

                viewer = viewer_of(origin.spec, replace(scenery(origin.spec, origin.meta), ghost="as it was"))
                stack.callback(viewer.close)
                samples = shown(samples, viewer.to_file(temporary), beside)
            return samples

        temporary = stack.enter_context(whole_file(rrd)) if rrd is not None else path
        return branch(path, at, changes, through)


def picture(target: Path, path: Path, found: Branched, at: float) -> None:
    """Both futures in a PNG, a panel a finger: pale as it was, dark as it would have been. Raises HandError."""
    from allegro_twin.description.appearance import lighter, of_series
    from allegro_twin.look.plot import Line, plot

    spec, panels = found.spec, {}
    names = spec.readable
    for finger in spec.fingers:
        was = [Line("", found.recorded[:, j], lighter(of_series(k)), 4) for k, j in enumerate(finger.joints)]
        would = [Line(names[j], found.branched[:, j], of_series(k)) for k, j in enumerate(finger.joints)]
        panels[f"{finger.name}, rad"] = [*was, *would]
    plot(target, found.t, panels, mark=at, title=f"{path.name}, otherwise from {at:g} s on; pale: as it was")


def table(path: Path, found: Branched, at: float) -> Table:
    """How far apart the two futures are, finger by finger, at some moments."""
    made = Table(title=f"{path.name}: both futures from {at:g} s, largest difference of a finger's joints, mrad")
    made.add_column("after")
    for finger in found.spec.fingers:
        made.add_column(finger.name, justify="right")
    off = 1000.0 * np.abs(found.branched - found.recorded[: len(found.branched)])
    for after in _AFTER:
        row = int(np.searchsorted(found.t, at + after - 1e-9))
        if row < len(off):
            made.add_row(f"{after:g} s", *(f"{off[row, list(f.joints)].max():.3f}" for f in found.spec.fingers))
    return made


def lines(found: Branched, at: float) -> Iterator[str]:
    """Whether anything changed, and what became of a grasp."""
    same = bool((found.branched == found.recorded[: len(found.branched)]).all())
    yield f"Until {at:g} s both are {_SAME}{'; and after it, too.' if same else '.'}"
    if found.report is not None:
        held = "held" if found.report.held else f"not held: {found.report.reason}"
        yield f"The grasp of the branch: {held}"
