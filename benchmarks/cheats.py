"""How far a task is solved by numbers that look at nothing: `python -m benchmarks.cheats [TASK …] [PAGE.md]`.

Two families, with half of the CPU time each: constants, u = c, 16 numbers; and an oscillation at f = 1 Hz, 32 numbers,
u = a cos 2πft + b sin 2πft. For `ArmPick` with `control="grasp"`, whose arm has somewhere to go: constants of 7
numbers, and 28 of straight lines between four knots. The cross-entropy method fits a normal distribution to the best
quarter of 16 drawn vectors by their return in two episodes each, other ones in every generation. What is reported is
the mean of the last distribution in 200 episodes that no search has seen. A task that such a search solves does not
ask for looking.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.policy.interface import Floats, Observation
from allegro_twin.learning.tasks import NO_BATCH, TASKS, task_type
from allegro_twin.learning.training.evaluation import Evaluation, evaluate
from allegro_twin.pick.env import ArmPick
from allegro_twin.types import Array
from benchmarks.pick import episode_of
from benchmarks.unlearned import SEED, chosen, levels, put, shown

DRAWN, EACH, BEST = 16, 2, 4
"""Vectors of a generation, episodes of each, and vectors that the next distribution is fitted to."""
SPREAD, LEAST, KEPT = 0.5, 0.02, 0.3
"""Standard deviations at first and at least, of actions of ±1; and the part of the old distribution in the next."""
FREQUENCY, MOTORS, EPISODES = 1.0, 16, 200
SEARCHED = 700_000_000
"""The first seed of episodes that are searched in."""
KNOTS = 4
"""Over an episode of `ArmPick`."""

HEAD = "| task | level | constants | 32 numbers | generations of each | CPU min | of |"


@dataclass
class OpenLoop:
    """Rows of numbers that act one after another decision, without a look at what is observed."""

    numbers: Array
    """(rows, 16 or 32)."""
    period: float
    """s, of a decision."""
    decision: int = field(default=0)

    def __call__(self, observation: Observation) -> Floats:
        seen = observation["observation"] if isinstance(observation, dict) else observation
        phase, self.decision = 2.0 * np.pi * FREQUENCY * self.period * self.decision, self.decision + 1
        first, second = self.numbers[:, :MOTORS], self.numbers[:, MOTORS:]
        action = np.cos(phase) * first + np.sin(phase) * second if second.size else first
        rows = np.broadcast_to(np.clip(action, -1.0, 1.0), (*seen.shape[:-1], MOTORS))
        return rows.astype(np.float32)


@dataclass
class CrossEntropy:
    """A normal distribution of vectors, without correlations."""

    mean: Array
    spread: Array

    @classmethod
    def wide(cls, size: int) -> CrossEntropy:
        return cls(np.zeros(size), np.full(size, SPREAD))

    def draw(self, random: np.random.Generator) -> Array:
        """Its mean among them, so that what is good is not lost by chance."""
        drawn = self.mean + self.spread * random.normal(size=(DRAWN, len(self.mean)))
        drawn[0] = self.mean
        return np.clip(drawn, -1.0, 1.0)

    def fit(self, drawn: Array, returns: Array) -> None:
        """To those with the largest returns, (rows,)."""
        best = drawn[np.argsort(-returns)[:BEST]]
        self.mean = KEPT * self.mean + (1.0 - KEPT) * best.mean(axis=0)
        self.spread = np.maximum(KEPT * self.spread + (1.0 - KEPT) * best.std(axis=0), LEAST)


@dataclass
class Line:
    """A straight line from knot to knot over an episode, without a look at what is observed."""

    knots: Array
    """(knots, numbers of an action)."""
    decisions: int
    """Of an episode."""
    decision: int = field(default=0)

    def __call__(self) -> Floats:
        at, self.decision = self.decision, self.decision + 1
        places = np.linspace(0.0, self.decisions - 1, len(self.knots))
        action = np.array([np.interp(at, places, column) for column in self.knots.T], np.float32)
        return np.clip(action, -1.0, 1.0)


Returns = Callable[[Array, int], Array]
"""Return of vectors, (rows, numbers), in two episodes each, the mean; the generation decides in which: (rows,)."""


def searched(returns: Returns, size: int, seconds: float) -> tuple[Array, int]:
    """The mean of the last distribution after so many CPU seconds, and after how many generations."""
    found, random, began, number = CrossEntropy.wide(size), np.random.default_rng(size), time.process_time(), 0
    while time.process_time() - began < seconds:
        drawn = found.draw(random)
        found.fit(drawn, returns(drawn, number))
        number += 1
    return found.mean, number


def rows(tasks: list[str], which: list[str], minutes: float) -> Iterator[str]:
    """Lines of the table, as they are found."""
    yield HEAD
    yield "|" + "---|" * (HEAD.count("|") - 1)
    for task, level, given in levels(task for task in tasks if task != NO_BATCH):
        if level in which or level == "—":
            yield _row(task, level, EnvSettings(timestep=0.003, **given), minutes)
    if NO_BATCH in tasks:
        yield _pick_row(minutes)


def _row(task: str, level: str, settings: EnvSettings, minutes: float) -> str:
    period = settings.period * settings.decimation

    def returns(drawn: Array, number: int) -> Array:
        policy = OpenLoop(np.repeat(drawn, EACH, axis=0), period)
        run = evaluate(policy, task, settings, DRAWN * EACH, seed=SEARCHED + number * DRAWN * EACH)
        found: Array = run.returns.reshape(DRAWN, EACH).mean(axis=1)
        return found

    cells, counts = [], []
    for size in (MOTORS, 2 * MOTORS):
        numbers, count = searched(returns, size, 30.0 * minutes)
        counts.append(str(count))
        cells.append(_cell(task, evaluate(OpenLoop(numbers[None], period), task, settings, EPISODES, seed=SEED)))
    return f"| `{task}` | {level} | {' | '.join(cells)} | {', '.join(counts)} | {minutes:g} | {EPISODES} |"


def _pick_row(minutes: float) -> str:
    env = ArmPick(control="grasp")
    numbers, length = env.numbers[1], env.episodes.limit

    def held_and_earned(vector: Array, seed: int) -> tuple[bool, float]:
        return episode_of(env, seed, lambda: Line(vector.reshape(-1, numbers), length))

    def returns(drawn: Array, number: int) -> Array:
        first = SEARCHED + number * DRAWN * EACH
        each = [[held_and_earned(row, first + k * EACH + one)[1] for one in range(EACH)] for k, row in enumerate(drawn)]
        found: Array = np.array(each).mean(axis=1)
        return found

    cells, counts = [], []
    for knots in (1, KNOTS):
        vector, count = searched(returns, knots * numbers, 30.0 * minutes)
        counts.append(str(count))
        held, earned = zip(*(held_and_earned(vector, SEED + k) for k in range(EPISODES)), strict=True)
        cells.append(shown(Evaluation(np.array(held), np.array(earned), ())))
    env.close()
    return f"| `{NO_BATCH}` | `grasp` | {' | '.join(cells)} | {', '.join(counts)} | {minutes:g} | {EPISODES} |"


def _cell(task: str, found: Evaluation) -> str:
    """A rate of success, and what the task counts."""
    counted = "" if found.counts is None else f"; {found.counts.mean():.2f} {task_type(task).count_unit}"
    return shown(found) + counted


def main() -> None:
    """Print the table, or put it into a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="Tasks; and a page to put the table into.")
    parser.add_argument("--minutes", type=float, default=10.0, help="CPU minutes for each task and level.")
    parser.add_argument("--levels", nargs="+", choices=("easy", "default"), default=["easy", "default"])
    asked = parser.parse_args()
    tasks, pages = chosen(asked.names, [*TASKS, NO_BATCH], "cheats")
    put(rows(tasks, asked.levels, asked.minutes), pages, "cheats", key=2)


if __name__ == "__main__":
    main()
