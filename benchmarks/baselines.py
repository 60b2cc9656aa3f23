"""What needs no learning, at every task and level: nothing, random actions, and the best constant squeeze.

`python -m benchmarks.baselines` prints the table; with the path of a page it is put between that page's marks.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.evaluate.statistics import wilson
from allegro_twin.gym.settings import EnvSettings
from allegro_twin.gym.tasks import TASKS, task_type
from allegro_twin.policy.controller import Policy, Still
from allegro_twin.policy.interface import Floats, Observation
from allegro_twin.train.evaluation import Evaluation, evaluate

EPISODES, SEED, JOINTS = 200, 500_000_000, 16
REACH = 0.3  # rad, of the residual tasks.
SQUEEZES = (0.05, 0.10, 0.15)  # rad on the flexion joints, from a quarter of the episode on.
FLEXION = np.array([0, 1, 1, 1] * 3 + [0, 0, 1, 1], np.float32)
SHUT = 0.25
BEGIN, END = "<!-- baselines -->", "<!-- /baselines -->"
HEAD = "| task | level | nothing | random | best constant | of |"


@dataclass(frozen=True)
class Squeeze:
    """A constant beyond the script, once the fingers have closed."""

    offset: float

    def __call__(self, observation: Observation) -> Floats:
        assert not isinstance(observation, dict)
        shut = observation[..., 64:65] > SHUT
        action: Floats = np.where(shut, FLEXION * np.float32(self.offset / REACH), np.float32(0.0))
        return action


class Random:
    """Uniform actions, the same ones at every run."""

    def __init__(self) -> None:
        self._generator = np.random.default_rng(0)

    def __call__(self, observation: Observation) -> Floats:
        seen = observation["observation"] if isinstance(observation, dict) else observation
        return self._generator.uniform(-1.0, 1.0, (*seen.shape[:-1], JOINTS)).astype(np.float32)


def rows(tasks: list[str], episodes: int = EPISODES) -> Iterator[str]:
    """Lines of the table, as they are found."""
    yield HEAD
    yield "|" + "---|" * (HEAD.count("|") - 1)
    for task in tasks:
        residual = "level" in task_type(task).own
        for level in ("easy", "default") if residual else ("—",):
            given: dict[str, Any] = {"level": level} if residual else {}
            nothing = _shown(_of(Still(JOINTS), task, given, episodes))
            random = _shown(_of(Random(), task, given, episodes))
            best = _constant(task, given, episodes) if residual else "—"
            yield f"| `{task}` | {level} | {nothing} | {random} | {best} | {episodes} |"


def _constant(task: str, given: dict[str, Any], episodes: int) -> str:
    found = {c: _of(Squeeze(c), task, given | {"control": "absolute"}, episodes) for c in SQUEEZES}
    best = max(found, key=lambda c: found[c].rate)
    return f"{_shown(found[best])} at {best:+.2f} rad"


def _of(policy: Policy, task: str, given: dict[str, Any], episodes: int) -> Evaluation:
    return evaluate(policy, task, EnvSettings(timestep=0.003, **given), episodes, seed=SEED)


def _shown(found: Evaluation) -> str:
    low, high = wilson(int(found.success.sum()), len(found.success))
    return f"{found.rate:.0%} ({low:.0%}–{high:.0%})".replace("%", " %")


def main(arguments: list[str]) -> None:
    """Print the table, or put it into a page."""
    lines = []
    for line in rows([name for name in TASKS if name in arguments] or list(TASKS)):
        print(line, flush=True)
        lines.append(line)
    for page in (Path(name) for name in arguments if name.endswith(".md")):
        before, rest = page.read_text().split(BEGIN, 1)
        page.write_text(before + BEGIN + "\n" + "\n".join(lines) + "\n" + END + rest.split(END, 1)[1])


if __name__ == "__main__":
    main(sys.argv[1:])
