"""What a trained policy is worth: beside the scripted player in the same episodes, on seen and unseen objects."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.policy.controller import Policy, Still
from allegro_twin.learning.policy.loading import load_policy
from allegro_twin.learning.tasks import make_task
from allegro_twin.learning.training.evaluation import Evaluation, evaluate, fitting, keywords
from allegro_twin.learning.training.progress import EVALUATION, round_seed
from allegro_twin.learning.training.settings import Recipe
from allegro_twin.viewing.camera import Picture
from allegro_twin.viewing.films import film

SEED = 3_000_000_000
"""Of an evaluation's first episode, where nobody chooses: never one of a training, nor of what was looked at while a
training was still being decided."""
SELECTION = 2_000_000_000
"""Of the evaluation with which a training ends, and which decides whether another one follows."""
LOOKED_AT = "trained on: by a look"
"""What `Recipe.looked_at` is called in reports."""


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """One set of episodes, with the policy and without."""

    name: str
    policy: Evaluation
    still: Evaluation
    """No action: the scripted player where the task has a script, else a hand that stays."""


def compare(path: Path, recipe: Recipe, episodes: int, seed: int = SEED) -> list[Compared]:
    """A policy file in all `sets`, in the episodes of the seeds from `seed` on. Raises ConfigError for a policy of
    another task."""
    loaded = load_policy(path)
    still = Still(loaded.card.action)
    fitting(loaded.card, make_task(recipe.task, as_shipped(recipe.environment), 1, 1).card())
    return [
        Compared(
            name,
            evaluate(loaded.policy, recipe.task, settings, episodes, seed=seed),
            evaluate(still, recipe.task, settings, episodes, seed=seed),
        )
        for name, settings in sets(recipe).items()
    ]


def sets(recipe: Recipe) -> dict[str, EnvSettings]:
    """The environments of an evaluation: with the objects that were trained on, with those by which a training was
    chosen, and with those that were kept from both. The physics is that of the environments as they ship, whatever the
    training used."""
    seen = as_shipped(recipe.environment)
    more = {LOOKED_AT: recipe.looked_at, "held out": recipe.held_out}
    others = {name: seen.model_copy(update={"objects": given}) for name, given in more.items() if given}
    return {"trained on": seen} | others


def overlap(recipe: Recipe, seed: int, episodes: int) -> str:
    """Which episodes of those from `seed` on a training of this recipe has used, in words; empty where none."""
    used = {
        "the evaluation after every round": range(EVALUATION, EVALUATION + recipe.trials),
        "the evaluation at the end of a training": range(SELECTION, SELECTION + episodes),
    }
    if recipe.learner == "stable-baselines3":
        for number in range(recipe.rounds):
            first = round_seed(recipe.seed, number)
            used[f"round {number + 1} of the training"] = range(first, first + recipe.envs)
    for name, seeds in used.items():
        if seed < seeds.stop and seeds.start < seed + episodes:
            return name
    return ""


def as_shipped(settings: EnvSettings) -> EnvSettings:
    """The same environments with the physics that they have by default, on processors, and nothing randomised."""
    own = ("timestep", "noslip", "coarse", "randomise", "device")
    given = {name: value for name, value in keywords(settings).items() if name not in own}
    return EnvSettings(**given)


def write(compared: list[Compared], path: Path) -> None:
    """As JSON: rates, standard errors, and successes of every object."""
    content = {each.name: {"policy": _figures(each.policy), "script": _figures(each.still)} for each in compared}
    with atomic_file(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1))


def filmed(policy: Policy, recipe: Recipe, path: Path, episodes: int = 3, seed: int = SEED) -> None:
    """A film of some episodes, of the seeds from `seed` on, on what was held out, or else trained on. Raises
    ConfigError where nothing renders."""
    settings = list(sets(recipe).values())[-1]
    env = HandEnv(recipe.task, render_mode="rgb_array", **keywords(settings))
    film(_pictures(env, policy, episodes, seed), path, round(1.0 / env.engine.task.interface.seconds))
    env.close()


def _pictures(env: HandEnv, policy: Policy, episodes: int, seed: int) -> Iterator[Picture]:
    for episode in range(episodes):
        observation, _ = env.reset(seed=seed + episode)
        over = False
        while not over:
            picture = env.render()
            assert picture is not None
            yield picture
            observation, _, terminated, truncated, _ = env.step(policy(observation))
            over = terminated or truncated


def quartiles(counted: NDArray[np.float64]) -> list[float]:
    """Three."""
    found: list[float] = np.percentile(counted, [25, 50, 75]).tolist()
    return found


def _figures(evaluation: Evaluation) -> dict[str, Any]:
    counted = evaluation.counted
    more: dict[str, Any] = (
        {} if counted is None else {"counted": {"mean": float(counted.mean()), "quartiles": quartiles(counted)}}
    )
    if evaluation.shares:
        more["shares"] = {name: float(share.mean()) for name, share in evaluation.shares.items()}
    return more | {
        "episodes": len(evaluation.success),
        "rate": evaluation.rate,
        "error": evaluation.error,
        "return": float(np.mean(evaluation.returned)),
        "objects": evaluation.by_thing(),
    }
