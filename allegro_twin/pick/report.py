"""Evaluation of a policy of `ArmPick`: beside the script in the same episodes, on known and held-out objects."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.errors import ConfigError
from allegro_twin.learning.training.report import HELD_OUT, SEED, Comparison, film_episodes
from allegro_twin.pick.card import contradiction, load_pick_policy, read_pick_card
from allegro_twin.pick.env import ArmPick
from allegro_twin.pick.recipe import PickRecipe
from allegro_twin.pick.rollouts import evaluate_pick
from allegro_twin.pick.settings import PickSettings


def compare_pick(policy: Path, recipe: PickRecipe, episodes: int, seed: int = SEED) -> list[Comparison]:
    """Evaluate a policy and the script, in the episodes of the seeds from `seed` on, with the training's objects and
    with those that it held out. `no_action` of the result is the script. Raises ConfigError for a policy of other
    environments, or one that was trained on a held-out object."""
    check_pick_policy(policy, recipe)
    return [
        Comparison(
            name,
            evaluate_pick(settings, episodes, policy, seed=seed, processes=recipe.envs),
            evaluate_pick(settings, episodes, None, seed=seed, processes=recipe.envs),
        )
        for name, settings in pick_sets(recipe).items()
    ]


def pick_sets(recipe: PickRecipe) -> dict[str, PickSettings]:
    """Environments of an evaluation."""
    known = recipe.environment
    held_out = {HELD_OUT: known.model_copy(update={"objects": recipe.held_out})} if recipe.held_out else {}
    return {"trained on": known} | held_out


def check_pick_policy(policy: Path, recipe: PickRecipe) -> None:
    """Raise ConfigError for a policy of other environments, or one that was trained on a held-out object."""
    trained = read_pick_card(policy).settings()
    if found := contradiction(trained, recipe.environment, PickSettings.model_fields):
        key, its, value = found
        raise ConfigError(
            f"the policy was trained with {key} {its}, these environments have {value}: give the recipe that it "
            "was trained with"
        )
    if others := sorted({*recipe.environment.objects} - {*trained.objects}):
        raise ConfigError(f"environment.objects: the policy was not trained on {others[0]}: name it in held_out")
    if known := sorted({*recipe.held_out} & {*trained.objects}):
        raise ConfigError(f"held_out: {known[0]} is among the objects that the policy was trained on: leave it out")


def film_pick(policy: Path, recipe: PickRecipe, path: Path, episodes: int = 3, seed: int = SEED) -> None:
    """Film some episodes of the seeds from `seed` on, on held-out objects, or else on those of the training. Raises
    ConfigError without a renderer."""
    settings = list(pick_sets(recipe).values())[-1]
    env = ArmPick(render_mode="rgb_array", **settings.keywords())
    film_episodes(env, load_pick_policy(policy).policy, path, env.episodes.seconds, episodes, seed)
