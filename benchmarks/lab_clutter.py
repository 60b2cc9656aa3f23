"""The cell with two or three objects on the table: which it takes, what it says, and what it moves on the way.

`python -m benchmarks.lab_clutter [--hand allegro] [--runs 20] [--seed 0] [--rows FILE]` draws objects, places and yaws:
the first within 6 cm of the middle, each other one at 8 to 30 cm from it. Prints the table of docs/results/cell.md.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.cell.assembly import make_cell, with_objects
from allegro_twin.cell.planning.stored_grasps import stored_grasps
from allegro_twin.cell.run import perform
from allegro_twin.cell.settings import LabSettings, TableObjectSettings
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from allegro_twin.sim.objects.catalogue import load_object

_GAP = 0.005  # m, between two at least.
Row = dict[str, Any]


def drawn(names: Sequence[str], draws: np.random.Generator) -> list[TableObjectSettings]:
    """Two or three objects, none in another."""
    chosen = draws.permutation(names)[: int(draws.integers(2, 4))]
    wide = [float(np.hypot(*load_object(str(name)).half_extents()[:2])) for name in chosen]
    at = draws.uniform(-0.06, 0.06, 2)
    places = [at]
    while len(places) < len(chosen):
        turn, far = draws.uniform(0.0, 2.0 * np.pi), draws.uniform(0.08, 0.3)
        place = at + far * np.array([np.cos(turn), np.sin(turn)])
        cell = [float(np.linalg.norm(place - other)) - wide[k] - wide[len(places)] for k, other in enumerate(places)]
        if min(cell) > _GAP and np.abs(place).max() < 0.4:
            places.append(place)
    yaws = draws.uniform(-180.0, 180.0, len(chosen)).tolist()
    return [TableObjectSettings(name=str(name), at=(float(place[0]), float(place[1])), yaw=yaw)
            for name, place, yaw in zip(chosen, places, yaws, strict=True)]  # fmt: skip


def tried(settings: LabSettings) -> Row:
    """One run, as a row."""
    cell = make_cell(settings)
    try:
        report = perform(cell)
    finally:
        cell.close()
    near = [float(np.hypot(*np.subtract(each.at, settings.objects[0].at))) for each in settings.objects[1:]]
    return {
        "objects": [each.name for each in settings.objects], "apart": near, "taken": report.object_name,
        "grasp": report.grasp, "end": str(report.end), "sentence": report.end.sentence, "truly": bool(report.is_lifted),
        "error": report.error, "moved": dict(report.moved), "doubt": bool(report.checked and report.checked.warning),
    }  # fmt: skip


def table(rows: Sequence[Row]) -> list[str]:
    """What came of it."""
    ends = Counter(row["end"] for row in rows).most_common()
    said = [row for row in rows if row["end"] == "held"]
    false = [row for row in said if not row["truly"]]
    stirred = [row for row in rows if row["moved"]]
    return [
        f"{len(rows)} runs: " + ", ".join(f"{end} {count}" for end, count in ends),
        f"said held {len(said)}, of which {len(false)} were not; of the others "
        f"{sum(row['truly'] for row in rows) - len(said) + len(false)} were",
        f"another object was moved in {len(stirred)}, at most by "
        f"{1e3 * max((max(row['moved'].values()) for row in stirred), default=0.0):.0f} mm",
        f"the force sensor was doubted in {sum(row['doubt'] for row in rows)}",
    ]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hand", default="allegro")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rows", type=Path)
    asked = parser.parse_args()
    settings = load_settings(LabSettings, data_root() / "conf" / f"lab_{asked.hand}.yaml")
    names, rows = sorted(card.name for card in stored_grasps(asked.hand)), []
    for number in range(asked.runs):
        draws = np.random.default_rng((asked.seed, number))
        rows.append(tried(with_objects(settings, drawn(names, draws), number)))
        if asked.rows is not None:
            with asked.rows.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
