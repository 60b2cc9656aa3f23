"""What a campaign of hidden hands found: a Markdown table beside the bars, and the JSON that is committed."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.sim.engine.backend import ENGINE
from allegro_twin.types import Array

Row = Mapping[str, Any]


class Bar(NamedTuple):
    """Of one kind of value: what it is called, its bars for matched and mismatched hands, and its unit."""

    label: str
    matched: str
    mismatched: str
    unit: str
    by: float
    """Times a stored error."""


BARS = {
    "torque_constant": Bar("torque constant", "0.5 / 2 %", "3 / 10 %", "%", 100.0),
    "damping": Bar("damping per k", "1 / 5 %", "5 / 15 %", "%", 100.0),
    "armature": Bar("armature per k", "2 / 5 %", "15 / 15 %", "%", 100.0),
    "frictionloss": Bar("dry friction per k", "0.5 mN·m", "10 % or 1 mN·m", "mN·m", 1000.0),
    "stiction": Bar("F_s/F_c", "", "± 0.2", "", 1.0),
    "stribeck_speed": Bar("v_s", "", "± 30 %", "%", 100.0),
    "load_friction": Bar("load friction, of the torque", "", "", "%", 100.0),
    "backlash": Bar("backlash, where seen", "", "", "mrad", 1000.0),
    "offset": Bar("offset", "2 mrad", "2 mrad", "mrad", 1000.0),
    "delay": Bar("delay", "0.3 ms", "0.5 ms", "ms", 1000.0),
}
OPEN_LOOP = {"matched": 2.0, "mismatched": 15.0}
"""mrad"""
CPU = {"matched": "≤ 60 s", "mismatched": "≤ 180 s"}


def table(rows: Sequence[Row], kind: str) -> Iterator[str]:
    """Of hands of one kind; figures are of determined values, and how many those are stands beside them."""
    seeds = ", ".join(str(row["seed"]) for row in sorted(rows, key=lambda row: row["seed"]))
    yield f"{kind}: {len(rows)} hands, seeds {seeds}"
    yield "| | median / p90 / worst | determined | intervals hold | bar |"
    yield "|---|---|---|---|---|"
    for name, bar in BARS.items():
        errors, inside, sure = (_all(rows, f"{name}{end}") for end in ("", "_inside", "_determined"))
        if (chosen := sure > 0).any():
            size = bar.by * np.abs(errors[chosen])
            said = " / ".join(f"{value:.2g}" for value in (np.median(size), np.percentile(size, 90), size.max()))
            count = f"{int(chosen.sum())} of {len(sure)}"
            held = f"{100 * inside[chosen].mean():.0f} %"
            yield f"| {bar.label} | {said} {bar.unit} | {count} | {held} | {getattr(bar, kind)} |"
    yield from _hands(rows, kind)


def _hands(rows: Sequence[Row], kind: str) -> Iterator[str]:
    """What is of a hand and not of a joint."""
    for label, there in (("with", True), ("without", False)):
        own = sorted((row for row in rows if (row["backlash_true"] > 0.0) == there), key=lambda row: row["seed"])
        if not own:
            continue
        after, before, best = (
            np.sqrt(np.square(np.array([json.loads(row[name]) for row in own])).mean(axis=1))
            for name in ("open_loop_mrad", "nominal_mrad", "truth_mrad")
        )
        seen, joints = sum(bool(row["loose"]) for row in own), np.abs(_all(own, "open_loop_mrad"))
        better, within = before / after, int((joints <= OPEN_LOOP[kind]).sum())
        said = " / ".join(f"{value:.2g}" for value in (np.median(joints), np.percentile(joints, 90), joints.max()))
        bar = f"≤ {OPEN_LOOP[kind]:g} mrad{', ≥ 10×' if kind == 'mismatched' else ''}"
        yield f"| hands {label} backlash of which some was seen | {seen} of {len(own)} | | | |"
        count = f"{within} of {len(joints)} within"
        yield f"| open loop 5 s, {label} backlash, by joint | {said} mrad | {count} | | {bar} |"
        yield f"| the same by hand | {_sorted(after)} mrad | | | {bar} |"
        yield f"| the same with the true drive | {_sorted(best)} mrad | | | |"
        nominal = f"{np.median(before):.0f} mrad; {np.median(better):.0f}×"
        yield f"| the same, nominal: median; better by, median | {nominal} | | | |"
    cost = np.array([60.0 * row["cpu_s"] / row["data_s"] for row in rows])
    yield f"| CPU for 60 s of data, median / worst | {np.median(cost):.0f} / {cost.max():.0f} s | | | {CPU[kind]} |"
    left = _all(rows, "residual")
    yield f"| left over, median / worst joint | {np.median(left):.2f} / {left.max():.1f} × noise | | | |"


def _sorted(values: Array) -> str:
    return ", ".join(f"{value:.2g}" for value in np.sort(values))


def write(path: Path, rows: Sequence[Row], command: str, machine: str) -> None:
    """A line a hand, by kind and seed; errors as they are, joint by joint."""
    plain = [
        {name: _plain(value) for name, value in row.items() if name not in ("key", "error")}
        for row in sorted(rows, key=lambda row: (row["kind"], row["seed"]))
    ]
    about = {"date": str(datetime.now(UTC).date()), "command": command, "engine": ENGINE, "machine": machine}
    lines = ",\n".join(json.dumps(row) for row in plain)
    path.write_text(json.dumps(about)[:-1] + f', "hands": [\n{lines}\n]}}\n')


def _plain(value: Any) -> Any:
    return json.loads(value) if isinstance(value, str) and value.startswith("[") else value


def _all(rows: Sequence[Row], name: str) -> Array:
    return np.concatenate([np.array(json.loads(row[name]), dtype=float) for row in rows])
