"""The whole cell on all 22 things: drawn places, perception in the loop; who is held, and what the checks say.

`python -m benchmarks.lab [--placements 5] [--seed 0] [--minutes 60] [--rows FILE]` prints the tables of docs/lab.md; a
placement of all things is whole before the next begins. Every trial that takes something is done again with the thing
taken away once it was seen: what the checks say then is their false alarms.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load
from allegro_twin.lab.cell import Room, make_room, with_things
from allegro_twin.lab.run import Report, perform
from allegro_twin.lab.settings import LabSettings, ThingSettings
from allegro_twin.lab.states import Now
from allegro_twin.sim.objects import catalogue

_AWAY = (2.0, 2.0, 1.0)  # m: off the table.
Row = dict[str, Any]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--placements", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rows", type=Path)
    asked = parser.parse_args()
    settings = load(LabSettings, data_root() / "conf" / "lab_allegro.yaml")
    once = settings.decide.model_copy(update={"retries": 0})
    began, rows = time.monotonic(), []
    for number in range(asked.placements):
        for index, name in enumerate(sorted(catalogue())):
            if time.monotonic() - began > 60.0 * asked.minutes:
                break
            draws = np.random.default_rng((asked.seed, number, index))
            at, yaw = draws.uniform(-0.08, 0.08, 2), float(draws.uniform(-180.0, 180.0))
            thing = ThingSettings(name=name, at=(float(at[0]), float(at[1])), yaw=yaw)
            row = tried(with_things(settings, [thing], 1000 * asked.seed + number), name)
            if row["grasp"] is not None:
                empty = with_things(settings, [thing], 1000 * asked.seed + number)
                row["empty"] = tried(empty.model_copy(update={"decide": once}), name, vanish=True)
            rows.append({**row, "placement": number, "yaw": yaw})
            if asked.rows is not None:
                with asked.rows.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
    print("\n".join(told(rows)))


def tried(settings: LabSettings, name: str, *, vanish: bool = False) -> Row:
    """One run, as a row. `vanish`: the thing is gone once it was seen."""
    room = make_room(settings)
    try:
        began = time.perf_counter()
        report = perform(room, entered=lambda now: _vanished(room, name, now) if vanish else None)
        return _row(report, name, time.perf_counter() - began)
    finally:
        room.close()


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
    checks = [(row["truly"], row) for row in rows] + [(False, row["empty"]) for row in rows if "empty" in row]
    for by in ("force", "torque"):
        counts = [[sum(truly == is_ and row[by] is said for truly, row in checks) for said in (True, False)]
                  for is_ in (True, False)]  # fmt: skip
        lines.append(f"| {by} | {counts[0][0]} | {counts[0][1]} | {counts[1][0]} | {counts[1][1]} |")
    return lines


def _vanished(room: Room, name: str, now: Now) -> None:
    if now.state == "ToTargetPose":
        room.cell.world.data.joint(name).qpos[:3] = _AWAY


def _row(report: Report, name: str, wall: float) -> Row:
    check = report.checked
    return {
        "name": name, "end": str(report.end), "sentence": report.end.sentence, "truly": bool(report.truly),
        "tries": report.tries, "grasp": report.grasp, "error": report.error, "lifted": report.lifted, "wall": wall,
        "t": report.events[-1][0], "force": None if check is None else check.by_force,
        "torque": None if check is None else check.by_torque,
        "weight": None if check is None else check.weight, "press": None if check is None else check.torque,
    }  # fmt: skip


if __name__ == "__main__":
    main()
