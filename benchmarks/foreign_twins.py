"""`python -m benchmarks.foreign_twins`: hidden hands with physics of other code identified, against nominal.

A hand of every kind of `foreign_hand.KINDS` and some seeds: 3 × 16 s in three poses, then 10 s in a pose that nothing
has seen. One JSON line a hand in `--out`, which is continued; `--show` prints the table. Open loop over 5 s, mrad: with
the nominal drive, with the hand's file as `identify` writes it, with all values as found; torque constants, of a hand
whose masses are assumed; pushes of 0.5 N that a mirror with the written file feels within 60 ms.
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

from allegro_twin.recording.reader import load
from allegro_twin.twin.identify.motions.motion import read_motion
from allegro_twin.twin.identify.pipeline import identify_hand, measure_gaps
from allegro_twin.twin.identify.results.findings import describe_terms
from allegro_twin.twin.identify.results.gap import gap_errors
from allegro_twin.twin.identify.results.hand_file import write_hand_file
from allegro_twin.twin.mirror.on_recording import mirror_recording
from benchmarks.foreign_hand import KINDS, Push, draw, recorded

POSES, UNSEEN = ("up", "palm-up", "side"), "palm-down"
FORCE, SOON, PUSHED = 0.5, 0.06, 30.0
"""N; s; s: of pushes, how soon they are to be felt, and how long the motion is."""
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
        drive = found.written.drive if not found.written.is_nominal else found.fit.drive
        every = gap_errors(motion, found.fit.player(motion), _leaning(found.fit.drive, drive))
        felt = _felt(kind, seed, folder, str(file) if file.exists() else "", unseen)
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
        "covered": covered, **felt,
        "bristly": found.fit.bristly, "loose": found.fit.loose,
        "said": list(describe_terms(found.fit, found.values, found.motions, found.written)),
    }  # fmt: skip


def line(row: dict[str, Any]) -> str:
    """A row of the table."""
    covered = ", ".join(f"{inside} of {of}" for inside, of in row["covered"].values())
    left = f"{row['residual'][0]:.1f} / {row['residual'][1]:.1f}"
    return (
        f"| {row['kind']} {row['seed']} | {row['nominal_mrad']:.0f} | {row['written_mrad']:.1f} | "
        f"{row['all_mrad']:.1f} | {row['worst_joint_mrad']:.1f} | {left} | "
        f"{covered} | {row['felt'][0]} of {row['felt'][1]}, {row['not_pushed']} others | "
        f"{row['threshold_mNm'][0]:.0f} | {row['cpu_s']:.0f} | "
        f"{' '.join(row['said'])} |"
    )


def _felt(kind: str, seed: int, folder: Path, hand: str, free: Path) -> dict[str, Any]:
    """Pushes of FORCE on fingers that move, how many a mirror with the hand's file names within SOON, and what else it
    takes for a touch."""
    rng = np.random.default_rng((seed, 5))
    pushes = []
    for begin in np.arange(2.5, PUSHED - 1.0, 0.9):
        way = rng.normal(size=3)
        pushes.append(Push(float(begin), 0.2, int(rng.integers(4)), FORCE * way / np.linalg.norm(way)))
    (path,) = recorded(kind, seed, (UNSEEN,), {UNSEEN: PUSHED}, folder, pushes=pushes, first=7)
    found, columns = mirror_recording(path, hand, free), load(path).columns
    fingers, felt, of, own = load(path).spec.fingers, 0, 0, set[int]()
    for push in pushes:
        rows = (columns["t"] >= push.begin - 0.05) & (columns["t"] < push.begin + 0.06)
        speed = np.abs(columns["velocity"][rows][:, list(fingers[push.finger].joints)]).mean(axis=0)
        while_pushed = [
            number
            for number, touch in enumerate(found.contacts)
            if touch.finger == fingers[push.finger].name and push.begin <= touch.begin < push.begin + push.seconds + 0.1
        ]
        own.update(while_pushed)
        if (speed > 0.1).sum() >= 2:
            of += 1
            felt += any(found.contacts[number].begin < push.begin + SOON for number in while_pushed)
    above = 1e3 * np.median(found.contact_thresholds, axis=0)
    return {
        "felt": [felt, of], "not_pushed": len(found.contacts) - len(own), "fault": str(found.faults or ""),
        "threshold_mNm": [float(np.median(above)), float(above.max())],
    }  # fmt: skip


def _covered(value: Any, true: Any) -> list[int]:
    """Of how many determined values the interval holds the truth, and how many are determined."""
    inside = np.abs(value.value - true) <= value.half
    return [int(inside[value.identifiable].sum()), int(value.identifiable.sum())]


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
