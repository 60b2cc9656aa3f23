"""What `plan` finds for hands that the library has no grasps of: the demo's objects, by the cards that are given.

    python -m benchmarks.hand_picks mine/shadow.yaml mine/inspire.yaml [--seed 0] [--quick] [--objects lemon,mug]

A row an object and hand: whether a grasp holds in the whole trial, and in how many of 20 draws that it was not chosen
on.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from allegro_twin.files.assets import data_root
from allegro_twin.grasping.plan.search import GraspSearch, RoundSize, SearchBudget
from allegro_twin.grasping.plan.templates import grasp_templates
from allegro_twin.grasping.plan.validate import judge_planned
from allegro_twin.hands import load_spec
from allegro_twin.surfaces.cli.grasps.plan import scenario_of

QUICK = RoundSize(guessed=72, closed=24, drawn=5)


def main() -> None:
    objects = sorted(path.stem for path in (data_root() / "scenarios" / "demo").glob("*.yaml"))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cards", nargs="+")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="smaller rounds than `plan` has, and half its time")
    parser.add_argument("--objects", default=",".join(objects))
    given = parser.parse_args()
    for card in given.cards:
        held = 0
        for name in given.objects.split(","):
            row, picked = tried(card, name, given.seed, quick=given.quick)
            held += picked
            print(f"{Path(card).stem:12} {name:18} {row}", flush=True)
        print(f"{Path(card).stem}: {held} of {len(given.objects.split(','))} held in the whole trial", flush=True)


def tried(card: str, thing: str, seed: int, *, quick: bool) -> tuple[str, bool]:
    """A line, and whether a grasp was found that holds."""
    spec, began = load_spec(card), time.process_time()
    scenario = scenario_of(thing, "z", None, None, 0.8).model_copy(update={"hand": card})
    search = GraspSearch(
        scenario, spec, grasp_templates(spec), seed=seed, effort=QUICK if quick else RoundSize(), threads=1
    )
    found = search.run(1, SearchBudget(cpu=60.0 if quick else 120.0))
    judge_planned(found, spec, search.uncertainty, seed, search.folder)
    spent = time.process_time() - began
    if not found:
        return f"none of {search.closed} candidates, {spent:.0f} CPU-s", False
    best = found[0]
    words = f"held in {best.judged_held} of {best.judged} draws, like {best.candidate.template}, {spent:.0f} CPU-s"
    return words, bool(best.confirmed)


if __name__ == "__main__":
    main()
