"""What the shipped policies are worth, in the episodes of `allegro-twin evaluate`.

`python -m benchmarks.policies FOLDER [POLICY …] [--episodes 1000] [--seed 3000000000] [--timestep 0.001] [--alone]`
simulates in chunks of 100 episodes. Every finished chunk is a line of FOLDER/results.jsonl, so that a run that was cut
off goes on where it was. Then it prints the table of docs/results/policies.md, intervals Wilson's (95 %), of what is
there; `--table`
prints it and simulates nothing. Another time step than what ships is said in the table.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.files.assets import data_root
from allegro_twin.grasping.statistics import wilson
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.policy.controller import Policy, ZeroPolicy
from allegro_twin.learning.policy.loading import load_policy
from allegro_twin.learning.training.evaluation import evaluate
from allegro_twin.learning.training.report import SEED, evaluation_sets, quartiles
from allegro_twin.learning.training.settings import load_recipe
from benchmarks.baselines import JOINTS, Squeeze

RECIPES = {
    "grasp_right": "grasp_easy",
    "pinch_right": "pinch",
    "hold_disturbed_right": "holddisturbed",
    "lift_right": "lift",
    "lift_leap": "lift_leap",
    "reach_right": "reach",
    "rotate_cradle_right": "rotate_cradle",
    "rotate_right": "rotate_on_palm",
    "rotate_hand_right": "rotate_on_palm_hand",
    "reorient_right": "reorient_on_palm",
}
CHUNK = 100
SCRIPT = "the script"
CONSTANTS = {"grasp_right": Squeeze("proximal", 0.10), "pinch_right": Squeeze("proximal", 0.20),
             "lift_right": Squeeze("proximal", 0.10), "hold_disturbed_right": Squeeze("flexion", 0.05),
             "lift_leap": Squeeze("leap's proximal", 0.20)}  # fmt: skip
"""What policies that add to a script are compared with, too: of five constants the best in other episodes, before."""
HEAD = "| policy | objects | acts | success | counted, mean (quartiles) | on the palm | of | seeds from, physics |"


def constant_of(policy: str) -> str:
    """In words; empty for a policy that adds to no script."""
    squeeze = CONSTANTS.get(policy)
    return "" if squeeze is None else f"+{squeeze.offset:.2f} rad, {squeeze.joints}"


@dataclass(frozen=True, slots=True)
class Case:
    """One cell: who acts, in which episodes."""

    policy: str
    objects: str
    acts: str
    timestep: float
    seed: int

    def settings(self) -> tuple[str, EnvSettings]:
        """The task, and its environments."""
        recipe = load_recipe(RECIPES[self.policy])
        more: dict[str, Any] = {"timestep": self.timestep}
        if self.acts == constant_of(self.policy):
            more |= {"control": "absolute", "state": False}  # A critic's numbers change no episode.
        return recipe.task, evaluation_sets(recipe)[self.objects].model_copy(update=more)

    def player(self) -> Policy:
        if self.acts == SCRIPT:
            return ZeroPolicy(JOINTS)
        if self.acts == constant_of(self.policy):
            return CONSTANTS[self.policy]
        return load_policy(data_root() / "conf" / "policies" / f"{self.policy}.onnx").policy

    def run(self, first: int) -> dict[str, Any]:
        """The chunk that begins with episode `first`."""
        found = evaluate(self.player(), *self.settings(), CHUNK, seed=self.seed + first, threads=1)
        return {
            "key": self.key(first),
            "success": found.success.astype(int).tolist(),
            "objects": list(found.objects),
            "counted": None if found.counts is None else found.counts.round(4).tolist(),
            "shares": {name: share.round(4).tolist() for name, share in found.shares.items()},
        }

    def key(self, first: int) -> list[Any]:
        return [self.policy, self.objects, self.acts, self.timestep, self.seed, first]


def cases(policies: list[str], timestep: float, seed: int, alone: bool) -> list[Case]:
    """What is measured; `alone`: the policies, and nothing that they are compared with."""
    found = []
    for policy in policies:
        for objects in evaluation_sets(load_recipe(RECIPES[policy])):
            acts = (policy, *([SCRIPT, constant_of(policy)] if policy in CONSTANTS and not alone else []))
            found += [Case(policy, objects, each, timestep, seed) for each in acts]
    return found


def rows(found: list[Case], results: dict[str, Any], episodes: int) -> Iterator[str]:
    """Lines of the table, of what is there."""
    yield HEAD
    yield "|" + "---|" * (HEAD.count("|") - 1)
    for case in found:
        chunks = [
            results[key] for first in range(0, episodes, CHUNK) if (key := json.dumps(case.key(first))) in results
        ]
        if not chunks:
            continue
        success = np.concatenate([chunk["success"] for chunk in chunks])
        low, high = wilson(int(success.sum()), len(success))
        rate = f"{success.mean():.1%} ({low:.1%}–{high:.1%})".replace("%", " %")
        counted = share = "—"
        if chunks[0]["counted"] is not None:
            values = np.concatenate([chunk["counted"] for chunk in chunks])
            error = values.std(ddof=1) / np.sqrt(len(values))
            counted = f"{values.mean():.2f} ± {error:.2f} ({', '.join(f'{each:.1f}' for each in quartiles(values))})"
        if chunks[0]["shares"]:
            share = f"{np.concatenate([chunk['shares']['on_palm'] for chunk in chunks]).mean():.1%}".replace("%", " %")
        where = f"{case.seed:,}, {case.timestep * 1000:g} ms"
        cells = (f"`{case.policy}`", case.objects, case.acts, rate, counted, share, str(len(success)), where)
        yield "| " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("policies", nargs="*", default=list(RECIPES))
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--timestep", type=float, default=EnvSettings().timestep)
    parser.add_argument("--objects", help="only this set of a recipe, such as 'held out'")
    parser.add_argument("--alone", action="store_true", help="only the policies, not what they are compared with")
    parser.add_argument("--table", action="store_true")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    path = asked.folder / "results.jsonl"
    lines = path.read_text().splitlines() if path.is_file() else []
    results = {json.dumps(chunk["key"]): chunk for chunk in map(json.loads, lines)}
    found = cases(asked.policies, asked.timestep, asked.seed, asked.alone)
    found = [case for case in found if asked.objects in (None, case.objects)]
    for first in [] if asked.table else range(0, asked.episodes, CHUNK):
        for case in found:
            if json.dumps(case.key(first)) in results:
                continue
            chunk = case.run(first)
            results[json.dumps(chunk["key"])] = chunk
            with path.open("a") as file:
                file.write(json.dumps(chunk) + "\n")
    print("\n".join(rows(found, results, asked.episodes)))


if __name__ == "__main__":
    main()
