"""Command `branch`: run the branch, record and plot it, print tables of differences."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from rich.table import Table

if TYPE_CHECKING:
    from allegro_twin.twin.branch.result import BranchOptions, BranchResult, ReferenceColumns
    from allegro_twin.types import Array, Sample

_AFTER = (0.0, 0.1, 0.3, 1.0, 3.0)  # s
_SAME = "the same to the last bit"
_INK = (0.15, 0.15, 0.15)


class BranchOutputs(NamedTuple):
    """Files that a branch writes."""

    record: Path | None = None
    rrd: Path | None = None


def warnings(path: Path, wanted: BranchOptions) -> Iterator[str]:
    """Warnings about the model that continues; none for a repeated simulation. Raises HandError."""
    from allegro_twin.recording.reader import load
    from allegro_twin.twin.branch.what_if import needs_model

    recording = load(path)
    if not needs_model(recording, wanted):
        return
    from allegro_twin.surfaces.cli.twin import identification

    identification.check_scipy()
    from allegro_twin.twin.identify.results.hand_file import mismatch_warning
    from allegro_twin.twin.mirror.factory import describe_backlash

    spec, hand = recording.spec, wanted.hand or recording.spec.serial
    if "torque" not in spec.commands:
        return
    if hand:
        yield mismatch_warning(identification.hand_file(hand))
    else:
        yield f"no --hand: {path} goes on with the nominal {spec.name}, not with its own hand"
    yield describe_backlash(spec, wanted.hand)


def run_branch(path: Path, at: float, texts: list[str], outputs: BranchOutputs, wanted: BranchOptions) -> BranchResult:
    """Run the branch, and record and draw it if requested; `target` then holds the recording's joint positions. Raises
    HandError."""
    from allegro_twin.app.session import rerun_stage
    from allegro_twin.recording.reader import load
    from allegro_twin.recording.recorder import check_other_file, record
    from allegro_twin.twin.branch.overrides import parse_changes
    from allegro_twin.twin.branch.what_if import branch_recording

    if outputs.record is not None:
        check_other_file(outputs.record, path)
    changes, origin = parse_changes(texts), load(path)
    with ExitStack() as stack:

        def through(samples: Iterator[Sample], beside: ReferenceColumns) -> Iterator[Sample]:
            if outputs.record is not None:
                meta = {k: value for k, value in origin.meta.items() if k in ("allegro_twin", "engine", "look")}
                meta["branch"] = {"of": path.name, "at": at, "set": changes, "hand": wanted.hand}
                samples = record(samples, outputs.record, origin.spec, origin.period, meta=meta, extras=beside)
            if outputs.rrd is not None:
                viewer_of, shown = rerun_stage()
                from allegro_twin.viewing.scenery import scenery

                viewer = viewer_of(origin.spec, replace(scenery(origin.spec, origin.meta), ghost="as it was"))
                samples = shown(samples, stack.enter_context(viewer.recorded(outputs.rrd)), beside)
            return samples

        return branch_recording(path, at, changes, through, wanted)


def draw_branch(target: Path, path: Path, found: BranchResult, at: float) -> None:
    """Plot all futures to a PNG, one panel for each finger: pale the recording, dark the branch, thin the model without
    a change. Raises HandError."""
    from allegro_twin.hands.description.appearance import lighten, series_color
    from allegro_twin.viewing.plot import Line, plot

    spec, panels, thin, first = found.spec, {}, found.unchanged, _first(found, at)
    names = spec.joint_labels
    for finger in spec.fingers:
        was = [Line("", found.recorded[:, j], lighten(series_color(k)), 4) for k, j in enumerate(finger.joints)]
        would = [Line(names[j], found.branched[:, j], series_color(k)) for k, j in enumerate(finger.joints)]
        model = [] if thin is None else [Line("", thin[first:, j], _INK, 1, first) for j in finger.joints]
        panels[f"{finger.name}, rad"] = [*was, *would, *model]
    also = "" if thin is None else "; thin and black: the model without the change"
    plot(target, found.t, panels, mark=at, title=f"{path.name}, otherwise from {at:g} s on; pale: as it was{also}")


def table(path: Path, found: BranchResult, at: float) -> Table:
    """Differences between the futures, by finger, at some instants. Simulation: recording and branch. Model: its error
    without the change, and the effect of the change."""
    model = found.unchanged is not None
    what = "the model's own error / what the change does" if model else "both futures"
    made = Table(title=f"{path.name}: {what} from {at:g} s, largest difference of a finger's joints, mrad")
    made.add_column("after")
    for finger in found.spec.fingers:
        made.add_column(finger.name, justify="right")
    apart = [1000.0 * np.abs(one - other) for one, other in _compared(found)]
    for after in _AFTER:
        row = int(np.searchsorted(found.t, at + after - 1e-9))
        if row >= len(apart[-1]):
            continue
        cells = [" / ".join(f"{_at(off, row, f.joints):.{3 - model}f}" for off in apart) for f in found.spec.fingers]
        made.add_row(f"{after:g} s" if found.t[row] < found.believed_until else f"({after:g} s)", *cells)
    if at + _AFTER[-1] >= found.believed_until:
        made.caption = f"in brackets: from {found.believed_until:.2f} s on do not believe it, as is said below"
    return made


def lines(found: BranchResult, at: float) -> Iterator[str]:
    """Notes: whether anything changed, the assumptions, and the outcome of a grasp."""
    if found.unchanged is not None:
        yield from found.notes
        yield _sizes(found, at)
        return
    same = bool((found.branched == found.recorded[: len(found.branched)]).all())
    yield f"Until {at:g} s both are {_SAME}{'; and after it, too.' if same else '.'}"
    if found.report is not None:
        held = "held" if found.report.held else f"not held: {found.report.reason}"
        yield f"The grasp of the branch: {held}"
    yield from found.notes


def _compared(found: BranchResult) -> list[tuple[Array, Array]]:
    """Pairs of trajectories to compare, of equal length."""
    if found.unchanged is None:
        return [(found.branched, found.recorded[: len(found.branched)])]
    both = min(len(found.branched), len(found.unchanged))
    return [(found.unchanged[:both], found.recorded[:both]), (found.branched[:both], found.unchanged[:both])]


def _first(found: BranchResult, at: float) -> int:
    """Row of the instant of the change."""
    return int(np.searchsorted(found.t, at - 1e-9))


def _at(off: Array, row: int, joints: tuple[int, ...]) -> float:
    return float(off[row, list(joints)].max())


def _sizes(found: BranchResult, at: float) -> str:
    """Model error and effect over all joints and all rows from the instant on that are to be believed."""
    rest = slice(_first(found, at), int(np.searchsorted(found.t, found.believed_until)))
    (model, effect), names = (one[rest] - other[rest] for one, other in _compared(found)), found.spec.joint_labels
    off, moved = (1000.0 * float(np.sqrt(np.square(each).mean())) for each in (model, effect))
    worst = np.abs(model).max(axis=0)
    until = f"Until {found.believed_until:.2f} s, without" if rest.stop < len(found.t) else "Without"
    said = f"{until} the change the model is off by {off:.2f} mrad rms (at most {1000.0 * worst.max():.2f}, "
    said += f"{names[int(worst.argmax())]})"
    if np.array_equal(*_compared(found)[1]):
        return f"{said}; nothing was changed."
    said += f"; the change moves the joints by {moved:.2f} mrad rms"
    return f"{said}." if moved > 2.0 * off else f"{said}: hardly more than the model is off by, so nothing follows."
