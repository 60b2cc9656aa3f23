"""The whole cell on all things that its hand has grasps of: drawn places, perception in the loop; what the checks say.

`python -m benchmarks.lab [--config lab_allegro] [--placements 5] [--seed 0] [--unlike] [--once] [--rows FILE]`
prints the tables of docs/results/cell.md; a placement of all things is whole before the next begins. Every trial that
takes
something is done twice more (not with `--once`), without a second try: with the thing taken away once it was seen, and
with it moved by 5 cm in a drawn direction when the approach begins. `--unlike`: the hand in the cell is not the one
that the checks know: its joints' friction differs by factors of 0.5 to 2, its motors by 0.85 to 1.15.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.cell.assembly import Cell, make_cell, with_objects
from allegro_twin.cell.planning.stored_grasps import stored_grasps
from allegro_twin.cell.run import LabReport, perform
from allegro_twin.cell.settings import LabSettings, TableObjectSettings
from allegro_twin.cell.states import MachineState
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from allegro_twin.types import Array

_MOVED = 0.05  # m.
_AWAY = (2.0, 2.0, 1.0)  # m: off the table.
Row = dict[str, Any]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--placements", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--config", default="lab_allegro")
    parser.add_argument("--unlike", action="store_true")
    parser.add_argument("--once", action="store_true")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rows", type=Path)
    asked = parser.parse_args()
    settings = load_settings(LabSettings, data_root() / "conf" / f"{asked.config}.yaml")
    once = settings.decide.model_copy(update={"retries": 0})
    names = sorted(card.name for card in stored_grasps(settings.hand.model))
    began, rows = time.monotonic(), []
    for number in range(asked.placements):
        for index, name in enumerate(names):
            if time.monotonic() - began > 60.0 * asked.minutes:
                break
            draws = np.random.default_rng((asked.seed, number, index))
            at, yaw = draws.uniform(-0.08, 0.08, 2), float(draws.uniform(-180.0, 180.0))
            thing = TableObjectSettings(name=name, at=(float(at[0]), float(at[1])), yaw=yaw)
            turn = float(draws.uniform(0.0, 2.0 * np.pi))
            here = with_objects(settings, [thing], 1000 * asked.seed + len(names) * number + index)
            unlike = (asked.seed, number, index, 1) if asked.unlike else None
            row = tried(here, name, unlike=unlike)
            if row["grasp"] is not None and not asked.once:
                here = here.model_copy(update={"decide": once})
                row["empty"] = tried(here, name, vanish=True, unlike=unlike)
                row["moved"] = tried(here, name, moved=_MOVED * np.array([np.cos(turn), np.sin(turn)]), unlike=unlike)
            rows.append({**row, "placement": number, "yaw": yaw})
            if asked.rows is not None:
                with asked.rows.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
    print("\n".join(told(rows)))


def tried(
    settings: LabSettings, name: str, *, vanish: bool = False, moved: Array | None = None,
    unlike: tuple[int, ...] | None = None,
) -> Row:  # fmt: skip
    """One run, as a row. `vanish`: the thing is gone once it was seen; `moved`: by so much when the approach begins,
    (2,), m; `unlike`: the seed by which the hand differs from the one that the checks know."""
    cell = make_cell(settings)
    if unlike is not None:
        _alter(cell, np.random.default_rng(unlike))

    def entered(now: MachineState) -> None:
        if vanish and now.state == "ToTargetPose":
            cell.robot.world.data.joint(name).qpos[:3] = _AWAY
        if moved is not None and now.state == "Approach":
            cell.robot.world.data.joint(name).qpos[:2] += moved

    try:
        began = time.perf_counter()
        report = perform(cell, on_state=entered)
        return _row(report, name, time.perf_counter() - began)
    finally:
        cell.close()


def told(rows: Sequence[Row]) -> list[str]:
    """The tables, line by line."""
    lines = ["| thing | held | said held | middle, mm | what else |", "|---|---|---|---|---|"]
    for name in sorted({row["name"] for row in rows}):
        mine = [row for row in rows if row["name"] == name]
        ends = sorted({f"{row['end']} (yaw {row['yaw']:.0f}°)" for row in mine if not row["truly"]})
        off = np.nanmedian([row["error"] for row in mine] + [np.nan]) * 1e3
        held, said = sum(row["truly"] for row in mine), sum(row["end"] == "held" for row in mine)
        lines.append(f"| {name} | {held} of {len(mine)} | {said} | {off:.1f} | {'; '.join(ends)} |")
    held, walls = sum(row["truly"] for row in rows), [row["wall"] for row in rows]
    again = sum(row["truly"] and row["tries"] > 1 for row in rows)
    lines += [
        "", f"held {held} of {len(rows)} ({held / len(rows):.0%}), {again} of them at the second try",
        f"wall time of a run: median {np.median(walls):.2f} s, 90 % {np.quantile(walls, 0.9):.2f} s",
        f"cycle in the scene's time: median {np.median([row['t'] for row in rows]):.1f} s",
        "",
        "| check | held, said held | held, said missed | empty, said held | empty, said missed |",
        "|---|---|---|---|---|",
    ]  # fmt: skip
    checks = [*rows] + [row[other] for other in ("empty", "moved") for row in rows if other in row]
    for by in ("force", "torque", "fingers"):
        counts = [[sum(row["truly"] == is_ and row[by] is said for row in checks) for said in (True, False)]
                  for is_ in (True, False)]  # fmt: skip
        lines.append(f"| {by} | {counts[0][0]} | {counts[0][1]} | {counts[1][0]} | {counts[1][1]} |")
    doubts = sum(row["doubt"] for row in checks)
    after = Counter(row["moved"]["end"] for row in rows if "moved" in row)
    wrong = [f"{row['name']}, {row['end']}, lifted by {1e3 * row['lifted']:.0f} mm" for row in checks
             if row["fingers"] is not None and row["fingers"] != row["truly"]]  # fmt: skip
    return [
        *lines, f"the force sensor was doubted in {doubts} of {len(checks)} runs",
        "a thing that was moved: " + ", ".join(f"{end} {count}" for end, count in after.most_common()),
        *(f"fingers were wrong: {each}" for each in wrong),
    ]  # fmt: skip


def _alter(cell: Cell, draws: np.random.Generator) -> None:
    model, spec = cell.robot.world.model, cell.hand.spec
    joints = [int(model.joint(name).dofadr[0]) for name in spec.joints]
    motors = [model.actuator(name).id for name in spec.joints]
    model.dof_frictionloss[joints] *= np.exp(draws.uniform(np.log(0.5), np.log(2.0), len(joints)))
    strength = draws.uniform(0.85, 1.15, len(motors))[:, None]
    model.actuator_gainprm[motors] *= strength  # Not the gear: a servo's angles would be scaled with it.
    model.actuator_biasprm[motors] *= strength


def _row(report: LabReport, name: str, wall: float) -> Row:
    check = report.checked
    return {
        "name": name, "end": str(report.end), "sentence": report.end.sentence, "truly": bool(report.is_lifted),
        "tries": report.tries, "grasp": report.grasp, "error": report.error, "lifted": report.lifted, "wall": wall,
        "t": report.events[-1][0], "force": None if check is None else bool(check.by_force),
        "torque": None if check is None else check.by_torque,
        "fingers": None if check is None else bool(check.by_fingers),
        "between": None if check is None else check.between, "doubt": bool(check is not None and check.warning),
        "weight": None if check is None else check.weight, "press": None if check is None else check.torque,
    }  # fmt: skip


if __name__ == "__main__":
    main()
