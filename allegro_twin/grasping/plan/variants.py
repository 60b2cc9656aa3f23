"""Versions of a grasp, all tried under the same draws: units of a sweep."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.errors import HandError
from allegro_twin.grasping.batch.trials import PERIOD, Bench, Case
from allegro_twin.grasping.scenario import Scenario, load_protocol
from allegro_twin.grasping.uncertainty import Draw
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import GraspFile
from allegro_twin.hands.library.grasps import Grasp, build_grasp, entry_from_grasp
from allegro_twin.spec import HandSpec
from allegro_twin.sweep.jobs import Sweep
from allegro_twin.sweep.local import SweepEngine
from allegro_twin.sweep.runner import run

TRIED = "allegro_twin.grasping.plan.variants:tried"
UNIT = 32
"""Trials in a unit at most, as they go side by side."""


@dataclass(frozen=True, slots=True, eq=False)
class Version:
    """A grasp and where its wrist is."""

    scenario: Scenario
    grasp: Grasp


class Try(NamedTuple):
    """What a trial showed; 0 and 1 for one that was stopped."""

    held: bool
    margin: float
    stall: float
    """Share of the time in which the joint that pushes hardest is at its torque limit."""


@dataclass(frozen=True, slots=True)
class Where:
    """What tries them: `at_once` processes of an engine, or, with one, all threads of this process."""

    engine: SweepEngine
    at_once: int
    folder: Path
    """Where the scenario's own files are looked for."""


def tries(
    versions: Sequence[Version], spec: HandSpec, protocol: str, draws: Sequence[Draw], where: Where
) -> list[list[Try]]:
    """A row for each version, an element for each draw. Raises HandError."""
    items = [{"version": plain(version, spec), "draw": asdict(draw)} for version in versions for draw in draws]
    shared = {"hand": spec.model_reference, "side": spec.side, "serial": spec.serial, "protocol": protocol,
              "folder": str(where.folder.resolve()), "threads": int(where.at_once > 1)}  # fmt: skip
    unit = len(items) if where.at_once == 1 else max(1, min(UNIT, len(items) // where.at_once))
    rows = iter(run(Sweep(TRIED, items, shared, unit), engine=where.engine).to_pylist())
    return [[_checked(next(rows)) for _ in draws] for _ in versions]


def tried(shared: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Units of the sweep: a row with the fields of `Try` for each item's version under its draw."""
    spec, rules = load_spec(shared["hand"], shared["side"], shared["serial"]), load_protocol(shared["protocol"])
    bench = Bench(spec, period=rules.period or PERIOD, threads=shared["threads"])
    return [each._asdict() for each in _made(bench, items, rules, Path(shared["folder"]))]


def plain(version: Version, spec: HandSpec) -> dict[str, Any]:
    """As JSON has it."""
    entry = entry_from_grasp(version.grasp, spec).model_dump(mode="json")
    return {"scenario": version.scenario.model_dump(mode="json"), "name": version.grasp.name, "grasp": entry}


def version_of(data: Mapping[str, Any], spec: HandSpec) -> Version:
    """What `plain` has made plain."""
    grasp = build_grasp(data["name"], GraspFile.model_validate(data["grasp"]), spec, data["name"])
    return Version(Scenario.model_validate(data["scenario"]), grasp)


def _made(bench: Bench, items: Sequence[Mapping[str, Any]], rules: Any, folder: Path) -> Iterator[Try]:
    cases = []
    for item in items:
        version = version_of(item["version"], bench.spec)
        cases.append(Case(version.scenario, version.grasp, Draw(**item["draw"]), rules, folder))
    for verdict in bench.verdicts(cases):
        report = verdict.report
        stall = 1.0 if report is None else max(report.at_limit.values())
        yield Try(verdict.held, 0.0 if report is None else report.margin, stall)


def _checked(row: Mapping[str, Any]) -> Try:
    if row["error"] is not None:
        raise HandError(row["error"])
    return Try(bool(row["held"]), float(row["margin"]), float(row["stall"]))


def score(row: Sequence[Try]) -> float:
    """How many draws it holds; among equals the one with larger margins and less time at a torque limit, as parts of
    one."""
    held = [each for each in row if each.held]
    margin = float(np.mean([each.margin for each in held] or 0.0))
    return len(held) + 0.49 * margin + 0.5 * (1.0 - float(np.mean([each.stall for each in held] or 1.0)))
