"""The cell with objects that nobody measured: drawn solids, one alone or two to six on a table that is to be cleared.

`python -m benchmarks.lab_drawn [--hand allegro] [--runs 20] [--first 0] [--clear | --concave] [--rows FILE]`. Boxes,
cylinders that stand or lie, balls and eggs of drawn sizes, 150 to 900 kg/m³; `--clear`: two to six of them, half of the
gaps 1 mm; `--concave`: mugs with a hollow and a handle, and L-shapes, of 1000 kg/m³, the corner twice.
Prints the tables of docs/results/cell.md.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from allegro_twin.cell.assembly import make_cell, with_objects
from allegro_twin.cell.run import perform
from allegro_twin.cell.settings import LabSettings, TableObjectSettings, TraySettings
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings

KINDS = ("box", "cylinder", "lying cylinder", "ball", "egg")
CONCAVE = ("mug", "L-shape")
_WALLS = 20  # Boxes around a mug.
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


def concave(number: int, folder: Path) -> TableObjectSettings:
    """Object `number`, a mug or an L-shape in turn, as one body of boxes and capsules in a file in `folder`."""
    draws, kind = np.random.default_rng((78, number)), CONCAVE[number % len(CONCAVE)]

    def between(low: float, high: float) -> float:
        return float(draws.uniform(low, high))

    if kind == "mug":
        radius, height, wall = between(0.033, 0.045), between(0.075, 0.105), between(0.003, 0.005)
        reach, thick, _ = between(0.02, 0.03), between(0.004, 0.006), between(0.15, 0.35)  # The file's is its mass.
        edge = np.tan(np.pi / _WALLS) * radius
        geoms = [_geom("cylinder", (radius, wall), (0.0, 0.0, wall - height / 2.0))]
        for angle in 2.0 * np.pi * np.arange(_WALLS) / _WALLS:
            side = (radius - wall / 2.0) * np.array([np.cos(angle), np.sin(angle), 0.0])
            geoms.append(_geom("box", (wall / 2.0, edge, height / 2.0), side.tolist(), f'euler="0 0 {angle:.5f}"'))
        bow = [(radius, 0.0, 0.3 * height), (radius + reach, 0.0, 0.2 * height),
               (radius + reach, 0.0, -0.2 * height), (radius, 0.0, -0.3 * height)]  # fmt: skip
        for begin, end in pairwise(bow):
            ends = " ".join(f"{value:.5f}" for value in (*begin, *end))
            geoms.append(f'<geom type="capsule" size="{thick:.5f}" fromto="{ends}"/>')
    else:
        height, thick = between(0.04, 0.09), between(0.025, 0.04)
        long, short = between(0.08, 0.13), between(0.05, 0.08)
        between(150.0, 900.0)  # A density that the file does not have: the next draws are as they were.
        geoms = [
            _geom("box", (long / 2.0, thick / 2.0, height / 2.0), (0.0, (thick - short) / 2.0, 0.0)),
            _geom("box", (thick / 2.0, short / 2.0, height / 2.0), ((thick - long) / 2.0, 0.0, 0.0)),
        ]
    path = folder / f"{kind}_{number}.xml"
    body = f'<body name="thing">{"".join(geoms)}</body>'
    path.write_text(f'<mujoco><compiler angle="radian"/><worldbody>{body}</worldbody></mujoco>')
    at = (between(-0.06, 0.06), between(-0.06, 0.06), height / 2.0 + 1e-4)
    yaw = between(-180.0, 180.0)
    return TableObjectSettings(name="thing", shape="mjcf", file=path, yaw=yaw, at=at)


def _geom(shape: str, size: Sequence[float], at: Sequence[float], more: str = "") -> str:
    sizes, place = (" ".join(f"{value:.5f}" for value in values) for values in (size, at))
    return f'<geom type="{shape}" size="{sizes}" pos="{place}" {more}/>'


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


def tried(settings: LabSettings, number: int, kind: str | None, objects: Sequence[TableObjectSettings]) -> Row:
    """One run, as a row."""
    began = time.process_time()
    cell = make_cell(with_objects(settings, objects, number))
    try:
        report = perform(cell)
        low = [one.name for one in objects if cell.robot.object_pose(one.name).position[2] < -0.01]
    finally:
        cell.close()
    return {
        "number": number, "kind": kind, "objects": len(objects),
        "end": str(report.end), "believed": str(report.believed or report.end),
        "sentence": report.end.sentence, "truly": bool(report.is_lifted), "grasp": report.grasp,
        "released": report.released, "in_tray": len(report.in_tray), "off_table": low, "tries": report.tries,
        "cpu": time.process_time() - began, "t": report.events[-1][0],
    }  # fmt: skip


def table(rows: Sequence[Row], kinds: Sequence[str]) -> list[str]:
    """What came of it."""
    cpu = f"CPU time of a run: median {np.median([row['cpu'] for row in rows]):.0f} s"
    if not kinds:
        believed = sum(row["believed"] == "cleared" != row["end"] for row in rows)
        total, inside = sum(row["objects"] for row in rows), sum(row["in_tray"] for row in rows)
        whole = sum(row["in_tray"] == row["objects"] for row in rows)
        ends = Counter(row["end"] for row in rows).most_common()
        return [
            f"{inside} of {total} objects ({inside / total:.0%}) in the tray, {whole} of {len(rows)} tables whole; "
            f"said {sum(row['released'] for row in rows)}; "
            f"off the table {sum(len(row['off_table']) for row in rows)}",
            "ends: " + ", ".join(f"{end} {count}" for end, count in ends) + f"; falsely taken for cleared: {believed}",
            cpu,
        ]  # fmt: skip
    lines = ["| kind | truly held | said held | what else |", "|---|---|---|---|"]
    for kind in (*kinds, None):
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
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--clear", action="store_true")
    what.add_argument("--concave", action="store_true")
    parser.add_argument("--rows", type=Path)
    asked = parser.parse_args()
    settings = load_settings(LabSettings, data_root() / "conf" / f"lab_{asked.hand}.yaml")
    if asked.clear:
        settings = settings.model_copy(update={"tray": TraySettings()})
    rows, kinds = list[Row](), () if asked.clear else CONCAVE if asked.concave else KINDS
    folder = Path(tempfile.mkdtemp())
    for number in range(asked.first, asked.first + asked.runs):
        one = [concave(number, folder)] if asked.concave else [drawn(number)]
        kind = kinds[number % len(kinds)] if kinds else None
        rows.append(tried(settings, number, kind, one if kinds else table_of(number)))
        if asked.rows is not None:
            with asked.rows.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    print("\n".join(table(rows, kinds)))


if __name__ == "__main__":
    main()
