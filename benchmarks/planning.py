"""What `plan` finds for all 22 objects: `python -m benchmarks.planning [OBJECT …] [--seconds 60] [--seed 31]`.

Each object lies on the table at its catalogue mass, friction 0.8; with `--household`, or `--more`, those of
benchmarks/household.py, meshes that nothing was tuned for. Five grasps are asked for. A line of JSON an object
is appended to out/planning_<seed>_<seconds>.jsonl: what is there is not tried again, so the command goes on after an
interruption. Held are the trials of draws that no search has seen: position ±5 mm, yaw ±10°, size ±5 %, mass ±20 %,
friction 0.5–1.0, together. `--air`: how many that differ by 2 cm or 20° are found in the air, under `fc` (100 g, six
pushes). Prints the tables of docs/results/planning.md.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.grasping.batch.batched_trials import Verdict
from allegro_twin.grasping.batch.trials import TrialCase, TrialRunner
from allegro_twin.grasping.plan.search import GraspSearch, SearchBudget
from allegro_twin.grasping.plan.templates import grasp_templates
from allegro_twin.grasping.plan.validate import SEARCHED
from allegro_twin.grasping.scenario import Scenario
from allegro_twin.grasping.uncertainty import sample_perturbations
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.taxonomy import ClaimedType
from allegro_twin.surfaces.cli.grasps.plan import scenario_of
from benchmarks.household import MORE, THINGS, write_things

WANTED, MANY = 5, 1000
YCB = "conf/objects/ycb.yaml"
UNSEEN = 999  # The seed of the draws that nobody has chosen on.


def planned(name: str, scenario: Scenario, seed: int, seconds: float, unseen: int) -> dict[str, Any]:
    """One object: how many were found in what time, and what share of unseen draws they hold."""
    spec = load_spec()
    search = GraspSearch(scenario, spec, grasp_templates(spec), seed=seed)
    wall, cpu = time.monotonic(), time.process_time()
    found = search.run(WANTED, SearchBudget(cpu=seconds))
    row: dict[str, Any] = {
        "object": name, "found": len(found), "seconds": round(time.monotonic() - wall, 1),
        "cpu_seconds": round(time.process_time() - cpu, 1), "candidates": search.closed, "ends": dict(search.ends),
        "margins": [round(each.margin, 2) for each in found], "draws": [[each.held, each.tried] for each in found],
    }  # fmt: skip
    if found and unseen:
        drawn = sample_perturbations(SEARCHED, unseen, seed=UNSEEN, stream="judge")
        cases = [TrialCase(each.scenario, each.grasp, draw, None, Path()) for each in found for draw in drawn]
        verdicts = list(TrialRunner(spec).verdicts(cases, stop_early=True))
        held = np.array([verdict.held for verdict in verdicts]).reshape(len(found), -1)
        row["held"], row["each"] = round(float(held.mean()), 3), held.mean(axis=1).round(3).tolist()
        claims = [each.grasp.taxonomy for each in found for _ in drawn]
        shown = [_shows(verdict, claim) for verdict, claim in zip(verdicts, claims, strict=True) if verdict.held]
        row["typed"] = round(float(np.mean(shown)), 3) if shown else None
    nominal = TrialRunner(spec).verdicts([TrialCase(each.scenario, each.grasp) for each in found])
    reports = [v.report for v in nominal if v.report is not None]
    row["sustained"] = [round(report.hottest[1], 3) for report in reports]
    row["penetration_mm"] = [round(1000.0 * report.penetration, 2) for report in reports]
    return row


def planned_in_air(name: str, scenario: Scenario, seed: int, seconds: float) -> dict[str, Any]:
    """One object: how many were found in what time."""
    spec = load_spec()
    search = GraspSearch(scenario.model_copy(update={"protocol": "fc"}), spec, grasp_templates(spec), seed=seed)
    wall = time.monotonic()
    found = search.run(MANY, SearchBudget(cpu=seconds))
    return {
        "object": name, "found": len(found), "seconds": round(time.monotonic() - wall, 1),
        "cpu_seconds": round(search.cpu, 1), "ends": dict(search.ends),
    }  # fmt: skip


def table_in_air(rows: Sequence[Mapping[str, Any]]) -> str:
    """As docs/results/planning.md has it."""
    lines = ["| object | grasps | CPU s | s | pushed out |", "|---|---|---|---|---|"]
    for row in rows:
        out = row["ends"].get("pushed out", 0)
        lines.append(f"| {row['object']} | {row['found']} | {row['cpu_seconds']:.0f} | {row['seconds']:.0f} | {out} |")
    return "\n".join(lines)


def _shows(verdict: Verdict, claim: ClaimedType) -> bool:
    """Whether the contacts of a trial show the type that the grasp's file claims."""
    assert verdict.report is not None
    observed = verdict.report.observed
    return observed is not None and observed.number == claim.number


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """As docs/results/planning.md has it."""
    lines = ["| object | grasps | CPU s | held of unseen draws | of these of the type claimed | most ended |"]
    lines.append("|---|---|---|---|---|---|")
    for row in rows:
        ends = {name: count for name, count in row["ends"].items() if name not in ("passed", "held")}
        worst = max(ends, key=lambda name: ends[name], default="—")
        held = f"{row['held']:.2f}" if "held" in row else "—"
        typed = f"{row['typed']:.2f}" if row.get("typed") is not None else "—"
        lines.append(f"| {row['object']} | {row['found']} | {row['cpu_seconds']:.0f} | {held} | {typed} | {worst} |")
    enough = sum(row["found"] >= WANTED for row in rows)
    shares = [row["held"] for row in rows if "held" in row]
    lines.append(
        f"\n{enough} of {len(rows)} with {WANTED}; unseen draws held {np.mean(shares or [np.nan]):.2f} on average"
    )
    return "\n".join(lines)


def known_things() -> dict[str, Scenario]:
    """Every object of the catalogue, upright on the table."""
    return {name: scenario_of(name, "z", None, None, 0.8) for name in read_yaml(data_root() / YCB)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("objects", nargs="*")
    parser.add_argument("--household", action="store_true")
    parser.add_argument("--more", action="store_true", help="twelve others of a household")
    parser.add_argument("--air", action="store_true")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--unseen", type=int, default=20)
    asked = parser.parse_args()
    kind = ("household" if asked.household else "more" if asked.more else "planning") + ("_air" if asked.air else "")
    path = Path(f"out/{kind}_{asked.seed}_{asked.seconds:g}.jsonl")
    path.parent.mkdir(exist_ok=True)
    if asked.household or asked.more:
        made = write_things(
            Path(f"out/{'household' if asked.household else 'more'}"), THINGS if asked.household else MORE
        )
        things = {name: scenario_of(str(file), "z", 1.0, mass, 0.8) for name, (file, mass) in made.items()}
    else:
        things = known_things()
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []
    wanted = asked.objects or list(things)
    for name in wanted:
        if name in {row["object"] for row in rows}:
            continue
        search = name, things[name], asked.seed, asked.seconds
        rows.append(planned_in_air(*search) if asked.air else planned(*search, asked.unseen))
        with path.open("a") as file:
            file.write(json.dumps(rows[-1]) + "\n")
        print(f"{name}: {rows[-1]['found']}", flush=True)
    print((table_in_air if asked.air else table)([row for row in rows if row["object"] in wanted]))


if __name__ == "__main__":
    main()
