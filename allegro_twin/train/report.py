"""What a trained policy is worth: beside the scripted player in the same episodes, on seen and unseen objects."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.files.whole import whole_file
from allegro_twin.gym.env import HandEnv
from allegro_twin.gym.settings import EnvSettings
from allegro_twin.gym.tasks import make_task
from allegro_twin.look.camera import Picture
from allegro_twin.look.films import film
from allegro_twin.policy.controller import Policy, Still
from allegro_twin.policy.loading import load_policy
from allegro_twin.train.evaluation import Evaluation, evaluate, fitting, keywords
from allegro_twin.train.settings import Recipe

SEED = 2_000_000_000  # Far from those of training and of the evaluations during it.


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """One set of episodes, with the policy and without."""

    name: str
    policy: Evaluation
    still: Evaluation
    """No action: the scripted player where the task has a script, else a hand that stays."""


def compare(path: Path, recipe: Recipe, episodes: int) -> list[Compared]:
    """A policy file in all `sets`. Raises ConfigError for a policy of another task."""
    loaded = load_policy(path)
    still = Still(loaded.card.action)
    fitting(loaded.card, make_task(recipe.task, as_shipped(recipe.environment), 1, 1).card())
    return [
        Compared(
            name,
            evaluate(loaded.policy, recipe.task, settings, episodes, seed=SEED),
            evaluate(still, recipe.task, settings, episodes, seed=SEED),
        )
        for name, settings in sets(recipe).items()
    ]


def sets(recipe: Recipe) -> dict[str, EnvSettings]:
    """The environments of an evaluation: with the objects that were trained on, and with those that were kept from it.
    The physics is that of the environments as they ship, whatever the training used."""
    seen = as_shipped(recipe.environment)
    if not recipe.held_out:
        return {"trained on": seen}
    return {"trained on": seen, "held out": seen.model_copy(update={"objects": recipe.held_out})}


def as_shipped(settings: EnvSettings) -> EnvSettings:
    """The same environments with the physics that they have by default, on processors, and nothing randomised."""
    own = ("timestep", "noslip", "coarse", "randomise", "device")
    given = {name: value for name, value in keywords(settings).items() if name not in own}
    return EnvSettings(**given)


def write(compared: list[Compared], path: Path) -> None:
    """As JSON: rates, standard errors, and successes of every object."""
    content = {each.name: {"policy": _figures(each.policy), "script": _figures(each.still)} for each in compared}
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1))


def filmed(policy: Policy, recipe: Recipe, path: Path, episodes: int = 3) -> None:
    """A film of some episodes on what was held out, or else trained on. Raises ConfigError where nothing renders."""
    settings = list(sets(recipe).values())[-1]
    env = HandEnv(recipe.task, render_mode="rgb_array", **keywords(settings))
    film(_pictures(env, policy, episodes), path, round(1.0 / env.engine.task.interface.seconds))
    env.close()


def _pictures(env: HandEnv, policy: Policy, episodes: int) -> Iterator[Picture]:
    for episode in range(episodes):
        observation, _ = env.reset(seed=SEED + episode)
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
    more = {} if counted is None else {"counted": {"mean": float(counted.mean()), "quartiles": quartiles(counted)}}
    return more | {
        "episodes": len(evaluation.success),
        "rate": evaluation.rate,
        "error": evaluation.error,
        "return": float(np.mean(evaluation.returned)),
        "objects": evaluation.by_thing(),
    }
