"""What every learner leaves behind, and what they agree on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from allegro_twin.learning.training.progress import Progress
from allegro_twin.learning.training.settings import Recipe

GOAL, ACHIEVED = "desired_goal", "achieved_goal"  # As Gymnasium names them.
STATE = "state"
Advance = Callable[[int, float, float], None]
"""Told after every update: the actions taken in all, and the mean return and success rate of the episodes that ended
since, NaN where none did."""
FINAL_RATE = 0.1  # Of the learning rate, at the end.
EVALUATION = 1_000_000_000  # Seeds of the evaluations: never those of training.
ROUND_SEEDS = 100_003  # Apart: more than there are simulations, so that no two rounds share a seed.


@dataclass(frozen=True, slots=True)
class Trained:
    """What a training has left behind."""

    policy: Path
    """The .onnx file."""
    progress: Progress
    rate: float
    """Success rate of the last evaluation, on what was trained on."""


def note(recipe: Recipe, progress: Progress) -> str:
    """How a policy was trained, for its card."""
    how = "PPO" if recipe.teacher is None else f"DAgger of {recipe.teacher}"
    how += "" if recipe.start is None else f" from {recipe.start} on"
    return f"{how}, seed {recipe.seed}, {progress.steps} actions in {progress.seconds:.0f} s"


def rate_of(recipe: Recipe, progress: Progress) -> float:
    """Of learning, in the next round: it falls in a straight line to a tenth."""
    return recipe.learning_rate * (1.0 - (1.0 - FINAL_RATE) * progress.rounds / recipe.rounds)


def round_seed(seed: int, rounds: int) -> int:
    """Of the first simulation in the round after so many, with Stable-Baselines3; the others' follow it."""
    return (seed + rounds * ROUND_SEEDS) % 2**31


def farthest_of(recipe: Recipe, progress: Progress) -> float | None:
    """How far goals are in the next round, rad, where the recipe says so."""
    if recipe.farthest is None:
        return None
    near, far = recipe.farthest
    return near + (far - near) * progress.rounds / max(recipe.rounds - 1, 1)
