"""`python -m benchmarks.twins`: hidden hands identified, against the bars of docs/results/identification.md; goes on
where it stopped.

The campaign: 20 matched hands and 20 mismatched ones, of these every third with 5 mrad of backlash. Each hand is a file
in `--out` when it is done, so that a kill loses only those at work; the same command goes on. `--show` computes nothing
and prints what there is as a table; `--write FILE` keeps it joint by joint: benchmarks/twins.json.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from allegro_twin.sweep import Local, Store, Sweep, run
from benchmarks.twin_table import table, write

BACKLASH = 0.005  # rad
KINDS = ("matched", "mismatched")


def main() -> None:
    chosen = _options().parse_args()
    kinds = KINDS if chosen.kind == "both" else (chosen.kind,)
    seeds = range(chosen.first, chosen.first + chosen.hands)
    items = [item(seed, kind, chosen.masses) for seed in seeds for kind in kinds]
    items.sort(key=lambda one: (one["backlash"] == 0.0, one["kind"] == "matched"))  # What takes longest comes first.
    sweep = Sweep("benchmarks.hidden_hands:rows", items, {"seconds": chosen.seconds}, unit=1)
    store = Store(chosen.out)
    if not chosen.show:
        run(sweep, store, Local(chosen.at_once), lambda done, total: print(f"{done} of {total}", flush=True))
    rows = [row for part in store.tables() for row in part.to_pylist()]
    good = [row for row in rows if not row.get("error")]
    if chosen.write:
        write(chosen.write, good, "python -m benchmarks.twins", chosen.machine)
    for kind in KINDS:
        if own := [row for row in good if row["kind"] == kind]:
            print("\n".join(table(own, kind)))
    for row in rows:
        if row.get("error"):
            print(f"not computed: {row['error']}")


def item(seed: int, kind: str, masses: str) -> dict[str, Any]:
    """A hand of the campaign."""
    own = seed + (100 if kind == "mismatched" else 0)
    backlash = BACKLASH if kind == "mismatched" and own % 3 == 2 else 0.0
    return {"seed": own, "kind": kind, "masses": masses, "side": ("right", "left")[seed // 2 % 2], "backlash": backlash}


def _options() -> argparse.ArgumentParser:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--kind", choices=(*KINDS, "both"), default="both")
    options.add_argument("--masses", choices=("known", "assumed"), default="known")
    options.add_argument("--hands", type=int, default=20, help="of each kind")
    options.add_argument("--first", type=int, default=0, help="seed of the first; mismatched ones are 100 later")
    options.add_argument("--seconds", type=float, default=16.0, help="in each of three poses")
    options.add_argument("--at-once", type=int, default=1, help="hands, each in a process of its own")
    options.add_argument("--show", action="store_true", help="what is there, and compute nothing")
    options.add_argument("--write", type=Path, metavar="FILE", help="what is there, joint by joint, as JSON")
    options.add_argument("--machine", default="", help="for --write: what it was computed on")
    options.add_argument("--out", type=Path, default=Path("out/twins"))
    return options


if __name__ == "__main__":
    main()
