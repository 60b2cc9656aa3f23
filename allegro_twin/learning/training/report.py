"""Evaluation report of a trained policy: beside the script alone in the same episodes, on known and held-out
objects."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, cast

import gymnasium
import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import find_file
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.files.schema import parse_settings
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.objects import ObjectChoice, OwnObject, object_name
from allegro_twin.learning.environments.settings import EnvSettings, env_keywords
from allegro_twin.learning.policy.card import check_card, read_card
from allegro_twin.learning.policy.controller import Policy, ZeroPolicy
from allegro_twin.learning.policy.loading import load_policy
from allegro_twin.learning.tasks import make_task, task_type
from allegro_twin.learning.tasks.base import task_named
from allegro_twin.learning.training.evaluation import Evaluation, evaluate
from allegro_twin.learning.training.progress import EVALUATION, round_seed
from allegro_twin.learning.training.settings import Recipe
from allegro_twin.viewing.camera import Picture
from allegro_twin.viewing.films import film

SEED = 3_000_000_000
"""Default first seed of an evaluation: never one of a training, nor one used while a training was being chosen."""
SELECTION = 2_000_000_000
"""First seed of the evaluation at the end of a training, which decides whether another one follows."""
TRAINED_ON = "trained on"
OTHERS = "the recipe's objects"
"""Name of the evaluation in a recipe's own environments where its objects are not all of the policy's training."""
LOOKED_AT = "trained on: by a look"
"""Name of `Recipe.looked_at` in reports."""
REPORT, FILM = "evaluation.json", "policy.mp4"
"""Files beside a trained policy."""
HELD_OUT = "held out"
"""Name of `Recipe.held_out` in reports."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """One set of episodes, with the policy and without."""

    name: str
    policy: Evaluation
    no_action: Evaluation
    """Without action: the script alone where the task has one, else a hand that stays."""


def compare_policy(path: Path, recipe: Recipe, episodes: int, seed: int = SEED) -> list[Comparison]:
    """Evaluate a policy file in all `evaluation_sets`, in the episodes of the seeds from `seed` on. Raises ConfigError
    for a policy of another task, and for objects that are held out or looked at and that the training, or that of the
    policy it began with or imitates, has."""
    loaded = load_policy(path)
    still = ZeroPolicy(loaded.card.action)
    task = make_task(recipe.task, as_shipped(recipe.environment), 1, 1)
    check_card(loaded.card, task.card())
    _check_unseen(recipe, task.object_names(), judged=path)
    trained = set(_trained_on(path)[1])
    known = TRAINED_ON if trained.issuperset(task.object_names()) else OTHERS
    return [
        Comparison(
            known if name == TRAINED_ON else name,
            evaluate(loaded.policy, recipe.task, settings, episodes, seed=seed),
            evaluate(still, recipe.task, settings, episodes, seed=seed),
        )
        for name, settings in evaluation_sets(recipe).items()
    ]


def evaluation_sets(recipe: Recipe) -> dict[str, EnvSettings]:
    """Environments of an evaluation: with the training's objects, with those by which the training was chosen, and with
    held-out ones; in the fingertips also with sizes and start states that no training has. The physics is the default
    one, whatever the training used."""
    known = as_shipped(recipe.environment)
    more = {LOOKED_AT: recipe.looked_at, HELD_OUT: recipe.held_out}
    found, other = {TRAINED_ON: known}, known
    if "starts" in task_type(recipe.task).own_settings and known.palm == "forbidden" and known.starts == "train":
        other = known.model_copy(update={"starts": "test"})
        found["unseen sizes"] = other
    return found | {name: other.model_copy(update={"objects": objects}) for name, objects in more.items() if objects}


def check_objects(recipe: Recipe, source: str = "recipe") -> None:
    """Raise ConfigError, with `source` and the key, for objects that are held out or looked at and that the training
    has, and for those that the task or the hand cannot have."""
    if not (recipe.held_out or recipe.looked_at):
        return
    try:
        task = make_task(recipe.task, as_shipped(recipe.environment), 1, 1)
    except ConfigError as error:
        raise ConfigError(f"{source}: {error}") from error
    _check_unseen(recipe, task.object_names(), f"{source}: ")
    sets = evaluation_sets(recipe)
    for name, key in ((LOOKED_AT, "looked_at"), (HELD_OUT, "held_out")):
        if name in sets:
            try:
                make_task(recipe.task, sets[name], 1, 1)
            except ConfigError as error:
                raise ConfigError(f"{source}: {key}: {error}") from error


def _check_unseen(recipe: Recipe, names: Sequence[str], before: str = "", judged: Path | None = None) -> None:
    """Raise ConfigError, whose text begins with `before`, for an object under two of: the training's, with these
    `names`, with those of the policies before it and of one that is `judged`; `looked_at`; `held_out`."""
    known = list(recipe.environment.objects or ())
    whose = dict.fromkeys(names, "the training's environments")
    for key, policy in (("start ", recipe.start), ("teacher ", recipe.teacher), ("", judged)):
        if policy is not None:
            theirs, of_it = _trained_on(policy)
            known += theirs
            whose = dict.fromkeys(of_it, f"the training of {key}{policy}") | whose
    for key in ("looked_at", "held_out"):
        choices: Sequence[ObjectChoice] = getattr(recipe, key)
        for choice in choices:
            name = object_name(choice)
            twin = next((each for each in known if _same_thing(each, choice)), choice)
            if (where := whose.get(object_name(twin))) is not None:
                called = "" if object_name(twin) == name else f" as {object_name(twin)}"
                raise ConfigError(
                    f"{before}{key}: {name} is among the objects of {where}{called}: leave it out of one of them"
                )
        known += choices
        whose |= {object_name(choice): key for choice in choices}


def _trained_on(policy: str | Path) -> tuple[Sequence[ObjectChoice], Sequence[str]]:
    """Objects of a policy's training, as its card has them, and the names of all that it drew from; none where the card
    does not say."""
    card = read_card(find_file(policy, "policy", "conf/policies", ".onnx"))
    if card.environment is None:
        return (), ()
    settings = parse_settings(EnvSettings, card.environment, f"{policy}: environment")
    return settings.objects or (), make_task(task_named(card.task), as_shipped(settings), 1, 1).object_names()


def _same_thing(one: ObjectChoice, other: ObjectChoice) -> bool:
    """Whether two objects that a user describes differ in nothing but their names and how they are grasped."""
    if not (isinstance(one, OwnObject) and isinstance(other, OwnObject)) or one.shape is None:
        return False
    of_both = {"name", "like"}
    return one.model_dump(exclude=of_both) == other.model_dump(exclude=of_both)


def seeds_overlap(recipe: Recipe, seed: int, episodes: int) -> str:
    """Which episodes from `seed` on a training of this recipe has used, as text; empty where none."""
    asked = range(seed, seed + episodes)
    for name, seeds in chain(_evaluation_seeds(recipe, episodes), _round_seeds(recipe)):
        if _overlap(asked, seeds):
            return name
    return ""


def check_seeds(recipe: Recipe, episodes: int = 0, source: str = "recipe") -> None:
    """Raise ConfigError, with `source`, for a training that would have episodes of its evaluations: of those after
    every round, and of the `episodes` at its end."""
    for name, seeds in _round_seeds(recipe):
        for evaluation, others in _evaluation_seeds(recipe, episodes):
            if _overlap(seeds, others):
                raise ConfigError(
                    f"{source}: seed {recipe.seed}: {name} has episodes of {evaluation}: choose another seed"
                )


def _evaluation_seeds(recipe: Recipe, episodes: int) -> Iterator[tuple[str, range]]:
    yield "the evaluation after every round", range(EVALUATION, EVALUATION + recipe.trials)
    yield "the evaluation at the end of a training", range(SELECTION, SELECTION + episodes)


def _round_seeds(recipe: Recipe) -> Iterator[tuple[str, range]]:
    """None of learners whose episodes are drawn otherwise."""
    for number in range(recipe.rounds if recipe.learner == "stable-baselines3" else 0):
        first = round_seed(recipe.seed, number)
        yield f"round {number + 1} of the training", range(first, first + recipe.envs)


def _overlap(one: range, other: range) -> bool:
    return max(one.start, other.start) < min(one.stop, other.stop)


def as_shipped(settings: EnvSettings) -> EnvSettings:
    """Settings with default physics, on processors, without randomisation. Where training draws from a twin these do,
    too: that hand is what the policy is for."""
    own = ("timestep", "noslip", "coarse", "randomise", "device")
    given = {name: value for name, value in env_keywords(settings).items() if name not in own}
    if (twin := settings.randomise.twin) is not None:
        given["randomise"] = {"twin": twin}
    return EnvSettings(**given)


def write_report(compared: list[Comparison], path: Path) -> None:
    """Write JSON: rates, standard errors, and successes of every object."""
    content = {each.name: {"policy": _figures(each.policy), "script": _figures(each.no_action)} for each in compared}
    with atomic_file(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1))


def film_policy(policy: Policy, recipe: Recipe, path: Path, episodes: int = 3, seed: int = SEED) -> None:
    """Film some episodes of the seeds from `seed` on, on held-out objects, or else on those of the training. Raises
    ConfigError without a renderer."""
    settings = list(evaluation_sets(recipe).values())[-1]
    env = HandEnv(recipe.task, render_mode="rgb_array", **env_keywords(settings))
    film_episodes(env, policy, path, env.engine.task.interface.seconds, episodes, seed)


def film_episodes(
    env: gymnasium.Env[Any, Any], policy: Policy, path: Path, seconds: float, episodes: int, seed: int
) -> None:
    """Film the episodes of the seeds from `seed` on, in an environment whose actions take so long, s; it is closed."""
    film(_pictures(env, policy, episodes, seed), path, round(1.0 / seconds))
    env.close()


def _pictures(env: gymnasium.Env[Any, Any], policy: Policy, episodes: int, seed: int) -> Iterator[Picture]:
    for episode in range(episodes):
        observation, _ = env.reset(seed=seed + episode)
        over = False
        while not over:
            yield cast(Picture, env.render())
            observation, _, terminated, truncated, _ = env.step(policy(observation))
            over = terminated or truncated


def quartiles(counted: NDArray[np.float64]) -> list[float]:
    """The three quartiles."""
    found: list[float] = np.percentile(counted, [25, 50, 75]).tolist()
    return found


def _figures(evaluation: Evaluation) -> dict[str, Any]:
    counted = evaluation.counts
    more: dict[str, Any] = (
        {} if counted is None else {"counted": {"mean": float(counted.mean()), "quartiles": quartiles(counted)}}
    )
    if evaluation.shares:
        more["shares"] = {name: float(share.mean()) for name, share in evaluation.shares.items()}
    return more | {
        "episodes": len(evaluation.success),
        "rate": evaluation.rate,
        "error": evaluation.error,
        "return": float(np.mean(evaluation.returns)),
        "objects": evaluation.by_object(),
    }
