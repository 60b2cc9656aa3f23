"""The cell with objects that nobody measured: drawn solids, one alone or two to six on a table that is to be cleared.

`python -m benchmarks.lab_drawn [--hand allegro] [--runs 20] [--first 0] [--clear] [--rows FILE]`. Boxes, cylinders that
stand or lie, balls and eggs of drawn sizes, 150 to 900 kg/m³; `--clear`: two to six of them, half of the gaps 1 mm.
Prints the tables of docs/results/cell.md.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from allegro_twin.cell.assembly import make_cell, with_objects
from allegro_twin.cell.run import perform
from allegro_twin.cell.settings import LabSettings, TableObjectSettings, TraySettings
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings

KINDS = ("box", "cylinder", "lying cylinder", "ball", "egg")
_NEAR, _APART = 0.001, 0.02  # m, between two.
_WITHIN = 0.13  # m, from the middle of the table along x and y.
Row = dict[str, Any]


def drawn(number: int) -> TableObjectSettings:
    """Object `number`: its kind is that of KINDS in turn."""
    draws, kind = np.random.default_rng((77, number)), KINDS[number % len(KINDS)]

    def between(low: float, high: float) -> float:
        return float(draws.uniform(low, high))

    shape: Literal["box", "cylinder", "sphere", "ellipsoid"]
    up: Literal["x", "z"] = "x" if kind == "lying cylinder" else "z"
    match kind:
        case "box":
            edges = sorted([between(0.03, 0.085), between(0.03, 0.12), between(0.03, 0.15)])
            size = tuple(draws.permutation(edges).tolist())
            if size[0] > 0.09 and size[1] > 0.09:
                size = (size[2], size[0], size[1])
            shape, volume = "box", float(np.prod(size))
        case "cylinder" | "lying cylinder":
            standing = kind == "cylinder"
            size = (
                (between(0.03, 0.085), between(0.04, 0.18)) if standing else (between(0.03, 0.075), between(0.07, 0.18))
            )
            shape, volume = "cylinder", np.pi / 4.0 * size[0] ** 2 * size[1]
        case "ball":
            size = (between(0.035, 0.095),)
            shape, volume = "sphere", np.pi / 6.0 * size[0] ** 3
        case _:
            short = between(0.035, 0.07)
            size = (short, short * between(1.1, 1.6))
            shape, volume = "ellipsoid", np.pi / 6.0 * short**2 * size[1]
    mass = float(np.clip(volume * between(150.0, 900.0), 0.015, 0.6))
    yaw, at = between(-180.0, 180.0), (between(-0.08, 0.08), between(-0.08, 0.08))
    return TableObjectSettings(name="thing", shape=shape, size=size, mass=round(mass, 4), up=up, yaw=yaw, at=at)


def table_of(number: int) -> list[TableObjectSettings]:
    """Two to six objects, none in another, half of the gaps 1 mm."""
    draws, found = np.random.default_rng((99, number)), list[TableObjectSettings]()
    wide = list[float]()
    most = int(draws.integers(2, 7))
    for _ in range(3000):
        one = drawn(int(draws.integers(0, 10**6)))
        assert one.size is not None
        level = np.array(one.size[:2] if one.shape == "box" else [max(one.size)] * 2) / 2.0
        radius = float(np.hypot(*level)) if one.shape == "box" else float(level[0])
        at, gap = draws.uniform(-_WITHIN, _WITHIN, 2), float(draws.choice([_NEAR, _APART]))
        away = [
            float(np.linalg.norm(at - other.at[:2])) - other_radius
            for other, other_radius in zip(found, wide, strict=True)
        ]
        if min(away, default=1.0) > radius + gap:
            place = (float(at[0]), float(at[1]))
            found.append(one.model_copy(update={"name": f"{one.shape}_{len(found)}", "at": place}))
            wide.append(radius)
        if len(found) == most:
            break
    return found


def tried(settings: LabSettings, number: int, *, clear: bool) -> Row:
    """One run, as a row."""
    objects = table_of(number) if clear else [drawn(number)]
    began = time.process_time()
    cell = make_cell(with_objects(settings, objects, number))
    try:
        report = perform(cell)
        low = [one.name for one in objects if cell.robot.thing(one.name).position[2] < -0.01]
    finally:
        cell.close()
    return {
        "number": number, "kind": None if clear else KINDS[number % len(KINDS)], "objects": len(objects),
        "end": str(report.end), "sentence": report.end.sentence, "truly": bool(report.is_lifted), "grasp": report.grasp,
        "released": report.released, "in_tray": len(report.in_tray), "off_table": low, "tries": report.tries,
        "cpu": time.process_time() - began, "t": report.events[-1][0],
    }  # fmt: skip


def table(rows: Sequence[Row], *, clear: bool) -> list[str]:
    """What came of it."""
    cpu = f"CPU time of a run: median {np.median([row['cpu'] for row in rows]):.0f} s"
    if clear:
        total, inside = sum(row["objects"] for row in rows), sum(row["in_tray"] for row in rows)
        whole = sum(row["in_tray"] == row["objects"] for row in rows)
        ends = Counter(row["end"] for row in rows).most_common()
        return [
            f"{inside} of {total} objects ({inside / total:.0%}) in the tray, {whole} of {len(rows)} tables whole; "
            f"said {sum(row['released'] for row in rows)}; "
            f"off the table {sum(len(row['off_table']) for row in rows)}",
            "ends: " + ", ".join(f"{end} {count}" for end, count in ends),
            cpu,
        ]  # fmt: skip
    lines = ["| kind | truly held | said held | what else |", "|---|---|---|---|"]
    for kind in (*KINDS, None):
        mine = [row for row in rows if kind in (row["kind"], None)]
        if mine:
            other = Counter(row["end"] for row in mine if row["end"] != "held")
            false = sum(row["end"] == "held" and not row["truly"] for row in mine)
            lines.append(
                f"| {kind or 'all'} | {sum(row['truly'] for row in mine)} of {len(mine)} | "
                f"{sum(row['end'] == 'held' for row in mine)} ({false} false) | "
                f"{', '.join(f'{end} {count}' for end, count in other.most_common())} |"
            )
    return [*lines, "", cpu]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hand", default="allegro")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--clear", action="store_true")
    parser.add_argument("--rows", type=Path)
    asked = parser.parse_args()
    settings = load_settings(LabSettings, data_root() / "conf" / f"lab_{asked.hand}.yaml")
    if asked.clear:
        settings = settings.model_copy(update={"tray": TraySettings()})
    rows = list[Row]()
    for number in range(asked.first, asked.first + asked.runs):
        rows.append(tried(settings, number, clear=asked.clear))
        if asked.rows is not None:
            with asked.rows.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    print("\n".join(table(rows, clear=asked.clear)))


if __name__ == "__main__":
    main()
