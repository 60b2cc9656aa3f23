"""What needs no learning, with hands that close their own loop: nothing, which is the script, and random actions.

`python -m benchmarks.hand_baselines [HAND …] [EPISODES]` prints the table; with the path of a page its rows are put
between that page's marks, in place of those of the same hands.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.policy.controller import Policy, ZeroPolicy
from allegro_twin.learning.training.evaluation import evaluate
from benchmarks.unlearned import SEED, Random, chosen, put, shown

EPISODES, MARK = 100, "hand baselines"
HANDS = ("leap", "model_o", "sih", "qb_softhand")
TASKS = ("Grasp", "Lift", "HoldDisturbed")
COARSE, FINE = 0.003, 0.001  # s, of the physics: the longer one where a hand bears it.
HEAD = "| hand | task | level | nothing: the script | random | of |"


def rows(hands: list[str], episodes: int = EPISODES) -> Iterator[str]:
    """Lines of the table, as they are found."""
    yield HEAD
    yield "|" + "---|" * (HEAD.count("|") - 1)
    for hand in hands:
        motors = load_spec(hand).n_actuators
        for task in TASKS:
            for level in ("easy", "default"):
                given = {"hand": hand, "level": level}
                found = [_shown(policy, task, given, episodes) for policy in (ZeroPolicy(motors), Random(motors))]
                yield f"| `{hand}` | `{task}` | {level} | {found[0]} | {found[1]} | {episodes} |"


def _shown(policy: Policy, task: str, given: dict[str, Any], episodes: int) -> str:
    settings = EnvSettings(timestep=COARSE if load_spec(given["hand"]).coarsest_step >= COARSE else FINE, **given)
    return shown(evaluate(policy, task, settings, episodes, seed=SEED))


def main(arguments: list[str]) -> None:
    """Print the table, or put it into a page."""
    episodes = next((int(text) for text in arguments if text.isdigit()), EPISODES)
    hands, pages = chosen([text for text in arguments if not text.isdigit()], HANDS, MARK)
    put(rows(hands, episodes), pages, MARK, key=3)


if __name__ == "__main__":
    main(sys.argv[1:])
