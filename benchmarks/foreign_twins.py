"""`python -m benchmarks.foreign_twins`: hidden hands with physics of other code identified, against nominal.

A hand of every kind of `foreign_hand.KINDS` and some seeds: 3 × 16 s in three poses, then 10 s in a pose that nothing
has seen. One JSON line a hand in `--out`, which is continued; `--show` prints the table. Open loop over 5 s, mrad: with
the nominal drive, with the hand's file as `identify` writes it, with all values as found; torque constants, of a hand
whose masses are assumed.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from allegro_twin.twin.identify.motions.motion import read_motion
from allegro_twin.twin.identify.pipeline import identify_hand, measure_gaps
from allegro_twin.twin.identify.results.findings import describe_terms
from allegro_twin.twin.identify.results.gap import gap_errors
from allegro_twin.twin.identify.results.hand_file import write_hand_file
from benchmarks.foreign_hand import KINDS, draw, recorded

POSES, UNSEEN = ("up", "palm-up", "side"), "palm-down"
SECONDS = dict.fromkeys(POSES, 16.0) | {UNSEEN: 10.0}


def main() -> None:
    chosen = _options().parse_args()
    done = {} if not chosen.out.exists() else {_key(row): row for row in map(json.loads, chosen.out.open())}
    for seed in range(chosen.first, chosen.first + chosen.hands):
        for kind in chosen.kinds or KINDS:
            if (kind, seed) not in done and not chosen.show:
                row = one(kind, seed)
                done[kind, seed] = row
                chosen.out.parent.mkdir(parents=True, exist_ok=True)
                with chosen.out.open("a") as file:
                    file.write(json.dumps(row) + "\n")
                print(line(row), flush=True)
    if chosen.show:
        print("\n".join(map(line, done.values())))


def one(kind: str, seed: int) -> dict[str, Any]:
    """A hand: recorded, identified, and judged on the motion that nothing has seen."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        *seen, unseen = recorded(kind, seed, (*POSES, UNSEEN), SECONDS, folder)
        began = time.process_time()
        found = identify_hand(seen, (), masses_known=False)
        cost, file = time.process_time() - began, folder / "hand.yaml"
        write_hand_file(file, found.fit, found.values, found.motions, "")
        (gap,) = measure_gaps([unseen], str(file) if file.exists() else "")
        motion = read_motion(unseen)
        drive = found.written.drive if not found.written.nothing else found.fit.drive
        every = gap_errors(motion, found.fit.player(motion), _leaning(found.fit.drive, drive))
    truth, constant = draw(kind, seed), found.values["torque_constant"]
    off = np.abs(constant.value - truth.constant)
    per_pwm = {"armature": truth.armature, "damping": truth.damping, "frictionloss": truth.friction}
    covered = {"torque_constant": _covered(constant, truth.constant)}
    covered |= {name: _covered(found.values[name], true / truth.constant) for name, true in per_pwm.items()}
    return {
        "kind": kind, "seed": seed, "cpu_s": cost,
        "nominal_mrad": 1e3 * gap.before.all[-1], "written_mrad": 1e3 * gap.after.all[-1],
        "worst_joint_mrad": 1e3 * gap.after.joint[-1].max(), "all_mrad": 1e3 * every.all[-1],
        "kept_back_mrad": {name: 1e3 * _rms(row) for name, row in found.written.errors.items()},
        "residual": [float(np.median(found.fit.spread.residual)), float(found.fit.spread.residual.max())],
        "constant_off": [float(np.median(off / truth.constant)), float((off / truth.constant).max())],
        "covered": covered,
        "bristly": found.fit.bristly, "loose": found.fit.loose,
        "said": list(describe_terms(found.fit, found.motions[0].spec.joint_labels)),
    }  # fmt: skip


def line(row: dict[str, Any]) -> str:
    """A row of the table."""
    covered = ", ".join(f"{inside} of {of}" for inside, of in row["covered"].values())
    left = f"{row['residual'][0]:.1f} / {row['residual'][1]:.1f}"
    return (
        f"| {row['kind']} {row['seed']} | {row['nominal_mrad']:.0f} | {row['written_mrad']:.1f} | "
        f"{row['all_mrad']:.1f} | {row['worst_joint_mrad']:.1f} | {left} | "
        f"{covered} | {row['cpu_s']:.0f} | "
        f"{' '.join(row['said'])} |"
    )


def _covered(value: Any, true: Any) -> list[int]:
    """Of how many determined values the interval holds the truth, and how many are determined."""
    inside = np.abs(value.value - true) <= value.half
    return [int(inside[value.determined].sum()), int(value.determined.sum())]


def _rms(row: Any) -> float:
    return float(np.sqrt(np.square(row).mean()))


def _leaning(drive: Any, written: Any) -> Any:
    """All values as found, with one lean of the palm for all recordings."""
    return replace(drive, tilt=written.tilt)


def _key(row: dict[str, Any]) -> tuple[str, int]:
    return row["kind"], row["seed"]


def _options() -> argparse.ArgumentParser:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--kinds", nargs="+", choices=KINDS, help="default: all")
    options.add_argument("--hands", type=int, default=1, help="of each kind")
    options.add_argument("--first", type=int, default=11, help="seed of the first")
    options.add_argument("--show", action="store_true", help="what is there, and compute nothing")
    options.add_argument("--out", type=Path, default=Path("out/foreign_twins.jsonl"))
    return options


if __name__ == "__main__":
    main()
