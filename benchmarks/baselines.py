"""What needs no learning, at every task and level: nothing, random actions, and the best constant squeeze.

`python -m benchmarks.baselines` prints the table; with the path of a page its rows are put between that
page's marks, in place of those of the same tasks.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.policy.controller import Policy, ZeroPolicy
from allegro_twin.learning.policy.interface import Floats, Observation
from allegro_twin.learning.tasks import TASKS
from allegro_twin.learning.training.evaluation import Evaluation, evaluate
from benchmarks.unlearned import SEED, Random, chosen, levels, put, shown

EPISODES, JOINTS, MARK = 200, 16, "baselines"
REACH = 0.3  # rad, of the residual tasks.
JOINTS_OF = {
    "flexion": np.array([0, 1, 1, 1] * 3 + [0, 0, 1, 1], np.float32),
    "proximal": np.array([0, 1, 0, 0] * 3 + [0, 0, 0, 0], np.float32),
    "leap's proximal": np.array([1, 0, 0, 0] * 3 + [0, 0, 0, 0], np.float32),
}
"""All joints that close, and of the three fingers the first of these, which leaves the thumb where it is."""
SQUEEZES = (("flexion", 0.05), ("flexion", 0.10), ("flexion", 0.15), ("proximal", 0.10), ("proximal", 0.20))
"""rad on some joints, from a quarter of the episode on."""
SHUT = 0.25
HEAD = "| task | level | nothing | random | best constant | of |"


@dataclass(frozen=True)
class Squeeze:
    """A constant beyond the script, once the fingers have closed."""

    joints: str
    offset: float

    def __call__(self, observation: Observation) -> Floats:
        assert not isinstance(observation, dict)
        shut = observation[..., 64:65] > SHUT
        action: Floats = np.where(shut, JOINTS_OF[self.joints] * np.float32(self.offset / REACH), np.float32(0.0))
        return action


def rows(tasks: list[str], episodes: int = EPISODES) -> Iterator[str]:
    """Lines of the table, as they are found."""
    yield HEAD
    yield "|" + "---|" * (HEAD.count("|") - 1)
    for task, level, given in levels(tasks):
        nothing = shown(_of(ZeroPolicy(JOINTS), task, given, episodes))
        random = shown(_of(Random(JOINTS), task, given, episodes))
        best = _constant(task, given, episodes) if given else "—"
        yield f"| `{task}` | {level} | {nothing} | {random} | {best} | {episodes} |"


def _constant(task: str, given: dict[str, Any], episodes: int) -> str:
    found = {which: _of(Squeeze(*which), task, given | {"control": "absolute"}, episodes) for which in SQUEEZES}
    joints, offset = max(found, key=lambda which: found[which].rate)
    return f"{shown(found[joints, offset])} at {offset:+.2f} rad, {joints}"


def _of(policy: Policy, task: str, given: dict[str, Any], episodes: int) -> Evaluation:
    return evaluate(policy, task, EnvSettings(timestep=0.003, **given), episodes, seed=SEED)


def main(arguments: list[str]) -> None:
    """Print the table, or put it into a page."""
    tasks, pages = chosen(arguments, list(TASKS), MARK)
    put(rows(tasks), pages, MARK, key=2)


if __name__ == "__main__":
    main(sys.argv[1:])
