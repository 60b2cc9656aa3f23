"""What needs no learning, with hands that close their own loop: nothing, which is the script, and random actions.

`python -m benchmarks.hand_baselines [HAND …] [EPISODES]` prints the table; with the path of a page it is put between
that page's marks.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.description.hands import load_spec
from allegro_twin.evaluate.statistics import wilson
from allegro_twin.gym.settings import EnvSettings
from allegro_twin.policy.controller import Policy, Still
from allegro_twin.policy.interface import Floats, Observation
from allegro_twin.train.evaluation import evaluate

EPISODES, SEED = 100, 500_000_000
HANDS = ("leap", "model_o", "sih", "qb_softhand")
TASKS = ("Grasp", "Lift", "HoldDisturbed")
COARSE, FINE = 0.003, 0.001  # s, of the physics: the last hand's 33 hinges hold less at 3 ms (Lift 46 %, not 71 %).
BEGIN, END = "<!-- hand baselines -->", "<!-- /hand baselines -->"
HEAD = "| hand | task | level | nothing: the script | random | of |"


class Random:
    """Uniform actions, the same ones at every run."""

    def __init__(self, motors: int) -> None:
        self._generator, self._motors = np.random.default_rng(0), motors

    def __call__(self, observation: Observation) -> Floats:
        seen = observation["observation"] if isinstance(observation, dict) else observation
        return self._generator.uniform(-1.0, 1.0, (*seen.shape[:-1], self._motors)).astype(np.float32)


def rows(hands: list[str], episodes: int = EPISODES) -> Iterator[str]:
    """Lines of the table, as they are found."""
    yield HEAD
    yield "|" + "---|" * (HEAD.count("|") - 1)
    for hand in hands:
        motors = load_spec(hand).n_actuators
        for task in TASKS:
            for level in ("easy", "default"):
                given = {"hand": hand, "level": level}
                found = [_shown(policy, task, given, episodes) for policy in (Still(motors), Random(motors))]
                yield f"| `{hand}` | `{task}` | {level} | {found[0]} | {found[1]} | {episodes} |"


def _shown(policy: Policy, task: str, given: dict[str, Any], episodes: int) -> str:
    settings = EnvSettings(timestep=FINE if given["hand"] == HANDS[-1] else COARSE, **given)
    found = evaluate(policy, task, settings, episodes, seed=SEED)
    low, high = wilson(int(found.success.sum()), len(found.success))
    return f"{found.rate:.0%} ({low:.0%}–{high:.0%})".replace("%", " %")


def main(arguments: list[str]) -> None:
    """Print the table, or put it into a page."""
    lines = []
    episodes = next((int(text) for text in arguments if text.isdigit()), EPISODES)
    for line in rows([hand for hand in HANDS if hand in arguments] or list(HANDS), episodes):
        print(line, flush=True)
        lines.append(line)
    for page in (Path(name) for name in arguments if name.endswith(".md")):
        before, rest = page.read_text().split(BEGIN, 1)
        page.write_text(before + BEGIN + "\n" + "\n".join(lines) + "\n" + END + rest.split(END, 1)[1])


if __name__ == "__main__":
    main(sys.argv[1:])
