"""`python -m benchmarks.twins`: hidden hands identified, against the bars of docs/twin.md; goes on where it stopped.

The campaign: 20 matched hands and 20 mismatched ones, of these every third with 5 mrad of backlash. A hand is written
to a file of its own when it is done, so that a kill loses those that were not; the same command goes on. `--show`
computes nothing and prints what there is, `--write FILE` keeps it joint by joint as JSON: benchmarks/twins.json.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.sim.backend import ENGINE
from allegro_twin.sweep import Local, Store, Sweep, run
from allegro_twin.types import Array


class Bar(NamedTuple):
    """A figure over all joints of all hands, beside its bar."""

    what: str
    figure: float
    bar: float
    unit: str


_NONE = float("nan")
BARS = {  # Matched, mismatched; median and 90th percentile.
    "torque_constant": ((0.5, 2.0), (3.0, 10.0), "%", 100.0),
    "damping": ((1.0, 5.0), (5.0, 15.0), "%", 100.0),
    "armature": ((2.0, 5.0), (15.0, 15.0), "%", 100.0),
    "frictionloss": ((0.5, 0.5), (1.0, 1.0), "mN·m", 1000.0),
    "offset": ((2.0, 2.0), (2.0, 2.0), "mrad", 1000.0),
    "delay": ((0.3, 0.3), (0.5, 0.5), "ms", 1000.0),
    "stiction": ((_NONE, _NONE), (0.2, 0.2), "", 1.0),
    "stribeck_speed": ((_NONE, _NONE), (30.0, 30.0), "%", 100.0),
    "load_friction": ((_NONE, _NONE), (_NONE, _NONE), "% of the torque", 100.0),
    "backlash": ((_NONE, _NONE), (_NONE, _NONE), "mrad", 1000.0),
}
BACKLASH = 0.005  # rad
_KINDS = ("matched", "mismatched")


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--kind", choices=(*_KINDS, "both"), default="both")
    options.add_argument("--masses", choices=("known", "assumed"), default="known")
    options.add_argument("--hands", type=int, default=20)
    options.add_argument("--first", type=int, default=0, help="seed of the first; mismatched ones are 100 later")
    options.add_argument("--seconds", type=float, default=16.0, help="in each of three poses")
    options.add_argument("--at-once", type=int, default=1, help="hands, each in a process of its own")
    options.add_argument("--write", type=Path, help="what is there as JSON, joint by joint")
    options.add_argument("--machine", default="", help="for --write: on what it was computed")
    options.add_argument("--show", action="store_true", help="what is there, and compute nothing")
    options.add_argument("--out", type=Path, default=Path("out/twins"))
    chosen = options.parse_args()
    kinds = _KINDS if chosen.kind == "both" else (chosen.kind,)
    seeds = range(chosen.first, chosen.first + chosen.hands)
    items = [item(seed, kind, chosen.masses) for seed in seeds for kind in kinds]
    items.sort(key=lambda one: (one["backlash"] == 0.0, one["kind"] == "matched"))  # What takes longest comes first.
    sweep = Sweep("benchmarks.hidden_hands:rows", items, {"seconds": chosen.seconds}, unit=1)
    store = Store(chosen.out)
    if not chosen.show:
        run(sweep, store, Local(chosen.at_once), lambda done, total: print(f"{done} of {total}", flush=True))
    table = [row for part in store.tables() for row in part.to_pylist()]
    if chosen.write:
        write(chosen.write, table, chosen.machine)
    for kind in kinds:
        rows = [row for row in table if row.get("kind") == kind and not row.get("error")]
        print(f"{kind}: {len(rows)} hands, seeds {sorted(row['seed'] for row in rows)}")
        for bar in figures(rows, kind) if rows else ():
            print(f"{bar.what:<64}{bar.figure:>10.2f} {bar.unit:<6}{bar.bar:>8.2f}")
    for row in table:
        if row.get("error"):
            print(f"not computed: {row['error']}")


def write(path: Path, table: Sequence[dict[str, Any]], machine: str) -> None:
    """A line a hand, by kind and seed; errors as they are, joint by joint."""
    hands = sorted((row for row in table if not row.get("error")), key=lambda row: (row["kind"], row["seed"]))
    plain = [
        {
            name: json.loads(value) if isinstance(value, str) and value.startswith("[") else value
            for name, value in row.items()
        }
        for row in ({name: row[name] for name in row if name not in ("key", "error")} for row in hands)
    ]
    about = {
        "date": str(datetime.now(UTC).date()),
        "command": "python -m benchmarks.twins",
        "engine": ENGINE,
        "machine": machine,
    }
    lines = ",\n".join(json.dumps(row) for row in plain)
    path.write_text(json.dumps(about)[:-1] + f', "hands": [\n{lines}\n]}}\n')


def item(seed: int, kind: str, masses: str) -> dict[str, Any]:
    """A hand of the campaign."""
    own = seed + (100 if kind == "mismatched" else 0)
    backlash = BACKLASH if kind == "mismatched" and own % 3 == 2 else 0.0
    return {"seed": own, "kind": kind, "masses": masses, "side": ("right", "left")[seed // 2 % 2], "backlash": backlash}


def figures(rows: Sequence[dict[str, Any]], kind: str) -> Iterator[Bar]:
    """Of determined values only; how many those are is a figure of its own."""
    for name, (*bars, unit, by) in BARS.items():
        median, tail = bars[_KINDS.index(kind)]
        errors, inside, determined = (_all(rows, f"{name}{end}") for end in ("", "_inside", "_determined"))
        if not len(determined):
            continue
        chosen = determined > 0
        yield Bar(f"{name}: determined", 100 * float(determined.mean()), 100.0, "%")
        if chosen.any():
            size = by * np.abs(errors[chosen])
            yield Bar(f"{name}: median error", float(np.median(size)), median, unit)
            yield Bar(f"{name}: 90th percentile", float(np.percentile(size, 90)), tail, unit)
            yield Bar(f"{name}: worst", float(size.max()), float("nan"), unit)
            yield Bar(f"{name}: intervals that hold the truth", 100 * float(inside[chosen].mean()), 95.0, "%")
    for name, there in (("seen where it is", True), ("seen where there is none", False)):
        seen = [bool(row["loose"]) for row in rows if (row["backlash_true"] > 0.0) == there]
        if seen:
            yield Bar(f"backlash: {name}, of {len(seen)} hands", float(sum(seen)), len(seen) * float(there), "hands")
    after, before = (
        np.sqrt(np.square(np.array([json.loads(row[name]) for row in rows])).mean(axis=1))
        for name in ("open_loop_mrad", "nominal_mrad")
    )
    bar = 2.0 if kind == "matched" else 15.0
    yield Bar("open loop 5 s, unseen pose and motion: median hand", float(np.median(after)), bar, "mrad")
    yield Bar("open loop 5 s: worst hand", float(after.max()), bar, "mrad")
    yield Bar("open loop 5 s: nominal, median hand", float(np.median(before)), float("nan"), "mrad")
    yield Bar("open loop 5 s: better than nominal, worst hand", float((before / after).min()), 10.0, "x")
    cost = np.array([60.0 * row["cpu_s"] / row["data_s"] for row in rows])
    yield Bar("CPU for 60 s of data, median", float(np.median(cost)), 60.0 if kind == "matched" else 180.0, "s")
    yield Bar("residual, median joint", float(np.median(_all(rows, "residual"))), float("nan"), "noise")


def _all(rows: Sequence[dict[str, Any]], name: str) -> Array:
    return np.concatenate([np.array(json.loads(row[name]), dtype=float) for row in rows])


if __name__ == "__main__":
    main()
