"""`python -m benchmarks.foreign_faults`: faults of hidden hands with physics of other code, and what mirrors call them.

A hand of `foreign_hand` is excited for 3 × 16 s and identified; a free motion of 46 s gives thresholds. Then one joint
goes wrong 5 s into a motion of 14 s, in a pose that nothing has seen: 20 to 60 mN·m of friction, 30 to 60 % of a
motor's torque, 30 to 80 g on one of a finger's outer links, or nothing. One JSON line a motion in `--out`, which is
continued; `--show` prints the table. A name counts as right with its joint, and if it stands at the end; any other is
false.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from allegro_twin.twin.identify.pipeline import identify_hand
from allegro_twin.twin.identify.results.hand_file import write_hand_file
from allegro_twin.twin.mirror.on_recording import mirror_recording
from benchmarks.foreign_hand import KINDS, Break, N, recorded
from benchmarks.foreign_twins import POSES, UNSEEN

SECONDS, FREE, BROKEN, BEGIN = 16.0, 46.0, 14.0, 5.0
"""s: of a motion to identify with, of the free one, of one in which a joint goes wrong, and when it does."""
NAMES = ("friction", "weak", "payload", "friction", "weak", "", "friction")
AMOUNTS = {"friction": (0.02, 0.06), "weak": (0.3, 0.6), "payload": (0.03, 0.08)}


def main() -> None:
    chosen = _options().parse_args()
    rows = [] if not chosen.out.exists() else [json.loads(line) for line in chosen.out.open()]
    for kind in () if chosen.show else chosen.kinds:
        known = {row["motion"] for row in rows if (row["kind"], row["seed"]) == (kind, chosen.seed)}
        if not (todo := set(range(chosen.motions)) - known):
            continue
        chosen.out.parent.mkdir(parents=True, exist_ok=True)
        for row in one(kind, chosen.seed, todo):
            rows.append(row)
            with chosen.out.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(json.dumps(row), flush=True)
    print(table(rows))


def one(kind: str, seed: int, motions: set[int]) -> Iterator[dict[str, Any]]:
    """A hand: identified, and then broken in many ways."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        found = identify_hand(
            recorded(kind, seed, POSES, dict.fromkeys(POSES, SECONDS), folder), (), masses_known=False
        )
        write_hand_file(folder / "hand.yaml", found.fit, found.values, found.motions, "")
        hand = str(folder / "hand.yaml") if (folder / "hand.yaml").exists() else ""
        (free,) = recorded(kind, seed, (UNSEEN,), {UNSEEN: FREE}, folder, first=9)
        for number in sorted(motions):
            broken = _draw(np.random.default_rng((seed, 77, number)), NAMES[number % len(NAMES)])
            (path,) = recorded(kind, seed, (UNSEEN,), {UNSEEN: BROKEN}, folder, breaks=broken, first=20 + number)
            seen = mirror_recording(path, hand, free)
            called = [(each.fault.name, each.fault.joint, each.fault.amount, each.named) for each in seen.faults]
            stands = [bool(np.isinf(each.ended)) for each in seen.faults]
            yield {
                "kind": kind, "seed": seed, "motion": number, "broken": [list(each[:3]) for each in broken],
                "called": called, "stands": stands, "touches": len(seen.contacts),
            }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """A row a hand."""
    lines = ["| hand | motions with a fault | named right | other names |", "|---|---|---|---|"]
    for kind, seed in dict.fromkeys((row["kind"], row["seed"]) for row in rows):
        own = [row for row in rows if (row["kind"], row["seed"]) == (kind, seed)]
        judged = [_judge(row) for row in own]
        broken = sum(bool(row["broken"]) for row in own)
        lines.append(f"| {kind} {seed} | {broken} | {sum(j[0] for j in judged)} | {sum(j[1] for j in judged)} |")
    return "\n".join(lines)


def _judge(row: dict[str, Any]) -> tuple[bool, int]:
    """Whether the fault was named, and how many other names came."""
    true = {tuple(each[:2]) for each in row["broken"]}
    right = [tuple(each[:2]) in true for each in row["called"]]
    named = any(good and stands for good, stands in zip(right, row["stands"], strict=True))
    return named, right.count(False)


def _draw(rng: np.random.Generator, name: str) -> list[Break]:
    joint = int(4 * rng.integers(4) + 1 + rng.integers(3)) if name == "payload" else int(rng.integers(N))
    return [Break(name, joint, float(rng.uniform(*AMOUNTS[name])), BEGIN)] if name else []


def _options() -> argparse.ArgumentParser:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--out", type=Path, default=Path("out/foreign_faults.jsonl"))
    options.add_argument("--kinds", nargs="*", choices=KINDS, default=list(KINDS))
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--motions", type=int, default=14)
    options.add_argument("--show", action="store_true")
    return options


if __name__ == "__main__":
    main()
