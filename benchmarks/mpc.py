"""`python -m benchmarks.mpc OUT.jsonl`: in-hand tasks by model predictive control, in the fingertips, in lockstep, with
the settings of conf/mpc.

Every line of the file is an episode; the same command goes on. `--show` prints the table.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.mpc import planner_settings, run_episodes

SHAPES = ("cube", "cylinder", "ball", "bar", "hex_nut")
COMMON: dict[str, Any] = {"timestep": 0.003, "decimation": 20, "starts": "test"}
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    **{f"Rotate {name}": ("Rotate", {"objects": (name,)}) for name in SHAPES},
    "Reorient yaw": ("Reorient", {"goals": "yaw"}),
    "Reorient any": ("Reorient", {}),
    "Rotate cube, leap": ("Rotate", {"objects": ("cube",), "hand": "leap"}),
    "Reorient yaw, leap": ("Reorient", {"goals": "yaw", "hand": "leap"}),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--episodes", type=int, default=1, help="of each case")
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--cases", nargs="+", choices=[*CASES], default=[*CASES])
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--show", action="store_true")
    chosen = parser.parse_args()
    rows = [json.loads(line) for line in chosen.out.open()] if chosen.out.exists() else []
    done = {(row["case"], row["seed"]) for row in rows}
    for seed in range(chosen.episodes):
        for case in chosen.cases:
            if chosen.show or (case, seed) in done:
                continue
            task, more = CASES[case]
            (found,) = run_episodes(
                task,
                EnvSettings(**COMMON | more),
                planner_settings(task),
                1,
                seed=seed,
                seconds=chosen.seconds,
                threads=chosen.threads,
            )
            row = {"case": case, "seed": seed, "asked": chosen.seconds} | asdict(found)
            with chosen.out.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(row, flush=True)
    if chosen.show:
        print("\n".join(table(rows)))


def table(rows: list[dict[str, Any]]) -> list[str]:
    """A row a case."""
    lines = [
        "| task | episodes | kept to the end | in the hand, s | turned or reached | a second | in a minute | "
        "by fingertips | processor s a decision |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for case in CASES:
        mine = [row for row in rows if row["case"] == case]
        if mine:
            seconds, counts = (np.array([row[key] for row in mine]) for key in ("seconds", "count"))
            unit = "rad" if case.startswith("Rotate") else "goals"
            lines.append(
                f"| {case} | {len(mine)} | {sum(row['kept'] for row in mine)} | {seconds.sum():.0f} | "
                f"{counts.sum():.1f} {unit} | {counts.sum() / seconds.sum():.2f} | "
                f"{60 * counts.sum() / seconds.sum():.1f} | "
                f"{np.mean([row['by_tips'] for row in mine]):.0%} | {np.mean([row['computing'] for row in mine]):.2f} |"
            )
    return lines


if __name__ == "__main__":
    main()
