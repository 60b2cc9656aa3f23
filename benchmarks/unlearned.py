"""What needs no learning, and the table of it in a page."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.grasping.statistics import wilson
from allegro_twin.learning.policy.interface import Floats, Observation
from allegro_twin.learning.tasks import task_type
from allegro_twin.learning.training.evaluation import Evaluation

SEED = 500_000_000


def levels(tasks: Iterable[str]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Each task at each of its levels: its name, the level's, and the setting that chooses it."""
    for task in tasks:
        residual = "level" in task_type(task).own_settings
        for level in ("easy", "default") if residual else ("—",):
            yield task, level, {"level": level} if residual else {}


class Random:
    """Uniform actions, the same ones at every run."""

    def __init__(self, motors: int) -> None:
        self._generator, self._motors = np.random.default_rng(0), motors

    def __call__(self, observation: Observation) -> Floats:
        seen = observation["observation"] if isinstance(observation, dict) else observation
        return self._generator.uniform(-1.0, 1.0, (*seen.shape[:-1], self._motors)).astype(np.float32)


def shown(found: Evaluation) -> str:
    """A rate of success with its 95 % interval."""
    low, high = wilson(int(found.success.sum()), len(found.success))
    return f"{found.rate:.0%} ({low:.0%}–{high:.0%})".replace("%", " %")


def put(lines: Iterable[str], pages: Iterable[str], mark: str) -> None:
    """Print a table as it is made, and then put it between the marks of pages."""
    table = []
    for line in lines:
        print(line, flush=True)
        table.append(line)
    begin, end = f"<!-- {mark} -->", f"<!-- /{mark} -->"
    for page in map(Path, pages):
        before, rest = page.read_text().split(begin, 1)
        page.write_text(before + begin + "\n" + "\n".join(table) + "\n" + end + rest.split(end, 1)[1])
