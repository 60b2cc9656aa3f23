"""The verdict on a recorded trial, from the recording alone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.grasping.verdict import Observations, PhaseWindow, Rule, TrialReport, judge
from allegro_twin.sim.engine.backend import ENGINE
from allegro_twin.spec import HandSpec
from allegro_twin.spec.thermal import ThermalData
from allegro_twin.types import Array
from allegro_twin.version import __version__


def rejudge(spec: HandSpec, columns: Mapping[str, Array], meta: Mapping[str, Any]) -> TrialReport | None:
    """Verdict on a recorded trial, as at its end; None where none was recorded to its end with what a verdict needs,
    and where somebody pulled the object with the mouse."""
    rule = meta.get("judged")
    if rule is None or np.any(columns.get("mouse_force", 0.0)):
        return None
    windows = [PhaseWindow(*row) for row in rule["windows"]]
    if not len(columns["t"]) or columns["t"][-1] < windows[-1].end - 1e-9:
        return None
    unseen = np.full((len(columns["t"]), 1), np.nan)  # Older recordings do not say it.
    observations = Observations(
        columns["t"], columns["palm"], columns["object"], columns["contact_force"], columns["on_table"][:, 0],
        columns.get("contacts", unseen)[:, 0], columns.get("penetration", unseen)[:, 0], columns["torque"],
    )  # fmt: skip
    return judge(
        observations, windows, Rule(**{key: rule[key] for key in rule if key != "windows"}),
        parts=[*(f.name for f in spec.fingers), "palm"], joints=spec.joint_labels,
        torque_limit=spec.actuation.torque_limit,
    )  # fmt: skip


def phase_results(report: TrialReport) -> dict[str, bool]:
    """Held or not in each phase that was checked."""
    return {phase.name: phase.held for phase in report.phases if phase.check}


def report_markdown(report: TrialReport, thermal: ThermalData | None) -> str:
    """A few lines of Markdown. `thermal`: of the hand."""
    lines = ["**held**" if report.held else f"**not held**: {report.reason}", ""]
    for phase in report.phases:
        if phase.check:
            lines.append(
                f"- {phase.name}: {'held' if phase.held else 'not held'}, moved {phase.drift * 1000:.1f} mm and "
                f"{phase.rotation:.1f}° in the hand{limits_left(phase.margin)}"
            )
    if not np.isnan(report.peak_torque):
        lines.append(f"- torque peak {100 * report.peak_torque:.0f} % of the limit")
    lines += [f"- {said}" for said in motor_load(report, thermal)]
    return "\n".join([*lines, f"- at most {report.penetration * 1000:.1f} mm in each other"])


def limits_left(margin: float) -> str:
    """The end of a sentence: the part of the limits on motion in the hand that is left. Empty where none is, as after
    a fall, and where nothing was checked."""
    return f", {100 * margin:.0f} % of the drift limits left" if margin >= 0.0 else ""


_MOMENT = 0.005
"""Share of the time below which a joint at its torque limit is not named."""


def stalled_joints(report: TrialReport) -> str:
    """The joints that push at their torque limit, and for how much of the time."""
    found = [f"{joint} {100 * part:.0f} %" for joint, part in report.at_limit.items() if part >= _MOMENT]
    return f"at the torque limit, of the time: {', '.join(found)}" if found else "no joint at its torque limit"


WARM = 60.0
"""°C from which the guard gives less."""


def motor_load(report: TrialReport, thermal: ThermalData | None) -> list[str]:
    """Statements on what the motors give: those that push at their limit; the joint that sustains most, and how long
    its motor bears that, by the hand's thermal data; and of which joints neither can be said."""
    joint, share = report.hottest
    unknown = [name for name, value in report.sustained.items() if np.isnan(value)]
    if not report.sustained or not joint:
        return ["effort unknown: nothing can be said of load or heat"] if unknown else ["no load was measured"]
    said = [stalled_joints(report), f"{joint} sustains {100 * share:.0f} % of its limit{_bears(share, thermal)}"]
    return said + ([f"effort of {', '.join(unknown)} unknown: nothing can be said of its load"] if unknown else [])


def _bears(share: float, thermal: ThermalData | None) -> str:
    if thermal is None:
        return " (no thermal data of this hand)"
    seconds = thermal.seconds_until(WARM, share)
    bears = f"{WARM:.0f} °C after {seconds:.0f} s" if np.isfinite(seconds) else f"never {WARM:.0f} °C"
    return f": {bears} (estimated; thermal data {thermal.source})"


def _finite(value: Any) -> Any:
    """Copy of content with None for every NaN and infinity, which JSON does not have."""
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def write_reports(path: Path, reports: dict[str, TrialReport]) -> None:
    """All verdicts with their margins as one JSON file; null where something is unknown."""
    content = {
        "allegro_twin": __version__,
        "engine": ENGINE,
        "trials": _finite({name: asdict(report) for name, report in reports.items()}),
    }
    with atomic_file(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1, default=dict, allow_nan=False))
