"""The gallery: a picture of every grasp of the library and a page of them (`allegro-twin gallery docs/reference`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from allegro_twin.app import assemble, scenario_config
from allegro_twin.app.config import RunConfig
from allegro_twin.files.assets import data_root
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.files.schema import load_settings
from allegro_twin.grasping.evaluation.campaign import (
    JUDGE,
    SamplingSettings,
    TargetOptions,
    find_targets,
    make_campaign,
)
from allegro_twin.grasping.evaluation.outcomes import row_rate, summarise
from allegro_twin.grasping.scenario import load_scenario
from allegro_twin.grasping.verdict import TrialReport
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import GraspFile
from allegro_twin.hands.library.library import grasp_names, load_grasp
from allegro_twin.hands.library.taxonomy import ObservedType
from allegro_twin.loop import run, until
from allegro_twin.sweep.jobs import Sweep
from allegro_twin.sweep.processors import core_count
from allegro_twin.sweep.runner import run as run_sweep
from allegro_twin.viewing.camera import Camera, Picture
from allegro_twin.viewing.views import View

_SIZE = 300
LAST = 34
_POSTURE = "posture: "


@dataclass(frozen=True, slots=True)
class GalleryEntry:
    """One grasp of the page."""

    name: str
    stored: GraspFile
    verdict: str
    rate: str = ""
    """Success rate under uncertainty, with its interval."""


def make(folder: Path, draws: int, advance: Callable[[str], None]) -> int:
    """Write <folder>/images/grasps/*.jpg and <folder>/grasps.md. Returns the number of grasps. Raises HandError."""
    rows = []
    for entry, picture in _entries(draws):
        with atomic_file(folder / "images" / "grasps" / f"{entry.name}.jpg") as temporary:
            Image.fromarray(picture).resize((_SIZE, _SIZE)).save(temporary, quality=82)
        rows.append(entry)
        advance(entry.name)
    rows.sort(key=_order)
    with atomic_file(folder / "grasps.md") as temporary:
        temporary.write_text(_page(rows, draws))
    return len(rows)


def _entries(draws: int) -> Iterator[tuple[GalleryEntry, Picture]]:
    for name in grasp_names():
        stored = load_settings(GraspFile, data_root() / "conf" / "grasps" / f"{name}.yaml")
        if stored.evidence and not stored.evidence.startswith(_POSTURE):
            report, picture = _perform(stored.evidence, name)
            margins = [phase for phase in report.phases if phase.check]
            drift = max(phase.drift for phase in margins) * 1000
            verdict = f"held, {drift:.1f} mm of drift" if report.held else f"not held: {report.reason}"
            often = _rate(stored.evidence, name, draws) if draws else ""
            stored = stored.model_copy(update={"observed": report.observed})
            yield GalleryEntry(name, stored, f"[{stored.evidence}](../../scenarios): {verdict}", often), picture
        else:
            reason = stored.evidence.removeprefix(_POSTURE) or "no scenario yet"
            yield GalleryEntry(name, stored, f"posture only: {reason}"), _pose(name)


def _perform(scenario: str, grasp: str) -> tuple[TrialReport, Picture]:
    """The verdict of a grasp's own trial, and a picture while the object is held up."""
    rig = assemble(scenario_config(scenario, "right", grasp))
    assert rig.trial is not None
    assert rig.sim is not None
    with closing(rig.backend), closing(Camera(rig.sim, view=View(150.0, -25.0, 0.42))) as camera:
        up = next(window.end for window in rig.trial.windows if window.check)
        picture: Picture | None = None
        for sample in rig.trial.watched(until(rig.trial.seconds, run(rig.backend, rig.controller))):
            if picture is None and sample.state.t >= up:
                picture = camera.take()
        assert picture is not None
        return rig.trial.report(), picture


def _rate(scenario: str, grasp: str, draws: int) -> str:
    """The rate of `allegro-twin evaluate SCENARIO --grasp GRASP --uncertainty DRAWS`."""
    _, path = load_scenario(scenario)
    targets = find_targets([path], TargetOptions(sides=("right",), grasp=grasp))
    items, shared, *_ = make_campaign(targets, SamplingSettings(draws))
    table = run_sweep(Sweep(JUDGE, items, shared, 1 + draws // core_count()))
    (row,) = summarise(targets, table.to_pylist())
    return str(row_rate(row))


def _pose(name: str) -> Picture:
    """A picture of a grasp without an object: the closed posture in the air."""
    posture = load_grasp(name, load_spec()).close.tolist()
    config = RunConfig.model_validate(
        {"backend": {"kind": "sim", "start": posture}, "task": {"posture": posture}, "controller": {"kind": "pd"}}
    )
    rig = assemble(config)
    assert rig.sim is not None
    with closing(rig.backend), closing(Camera(rig.sim, view=View(215.0, -15.0, 0.36))) as camera:
        for _ in until(0.3, run(rig.backend, rig.controller)):
            pass
        return camera.take()


def _type_text(kind: ObservedType) -> str:
    """Type of a grasp with its opposition and what carries the object; for none of the 33 types the reason."""
    place = ", ".join(filter(None, (str(kind), kind.type, kind.opposition)))
    why = f" ({kind.why})" if kind.why else ""
    return f"{place}{why}. {kind.virtual_fingers}.<br>{kind.carries}"


def _order(row: GalleryEntry) -> tuple[int, str]:
    """Sort key: number of the type; last those of no type, and those that hold nothing."""
    observed = row.stored.observed
    return (LAST + 1 if observed is None else observed.number or LAST), row.name


def _page(rows: list[GalleryEntry], draws: int) -> str:
    proved = [row.stored.observed for row in rows if row.stored.observed and "](../../scenarios): held" in row.verdict]
    types = {observed.number for observed in proved if observed.number is not None}
    none = sum(observed.number is None for observed in proved)
    again = f"allegro-twin evaluate SCENARIO --grasp NAME --uncertainty {draws}"
    often = (
        ""
        if not draws
        else f"""The last column is how often a grasp holds under uncertainty: {draws} draws of pose (±10 mm, ±10°),
size, mass, friction and torque, with the 95 % Wilson interval (`{again}`).
"""
    )
    head = f"""# The grasps

*Reference: every grasp of the library, with picture and evidence. Made by `allegro-twin gallery docs/reference`.*

{len(rows)} grasps, {len(proved)} of which hold an object in simulation, by the definition in
[scenario files](scenario_files.md#protocols), with either hand: one trial each, the same each time.

They are of {len(types)} of the 33 types of the GRASP taxonomy (Feix et al., IEEE Trans. Human-Machine Systems 46(1),
2016); {none} are of none. The type is that of the contacts which carry the object ([how](grasp_types.md)), not of the
name: many names are those of the types that the postures were drawn after. Where nothing was held it is not known.

{often}Perform one with `allegro-twin grasp NAME`, and its trial with `allegro-twin run SCENARIO --view`.

| | grasp | type | for | evidence |{" in draws |" if draws else ""}
|---|---|---|---|---|{"---|" if draws else ""}
"""
    lines = []
    for row in rows:
        kind, size = row.stored.observed, row.stored.object_size
        width = "" if size is None else f"{size[0] * 1000:g}–{size[1] * 1000:g} mm"
        control = "" if row.stored.grip is None else f" Controls force ({row.stored.grip.kind})."
        lost = kind is None or "](../../scenarios): held" not in row.verdict
        lines.append(
            f'| <img src="images/grasps/{row.name}.jpg" width="150"> '
            f"| **{row.name}**<br>{row.stored.description}{control} "
            f"| {'not known' if lost or kind is None else _type_text(kind)} | {width} "
            f"| {row.verdict} |" + (f" {row.rate} |" if draws else "")
        )
    return head + "\n".join(lines) + "\n"
