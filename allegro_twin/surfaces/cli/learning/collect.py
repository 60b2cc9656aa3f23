"""The command `collect`: episodes of an environment as a data set."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import RecordingError
from allegro_twin.surfaces.cli import completion, options

if TYPE_CHECKING:
    from allegro_twin.learning.policy.controller import Policy
    from allegro_twin.learning.training.settings import Recipe
    from allegro_twin.recording.exchange.environment_episodes import EnvironmentEpisode

NOTHING = "nothing"
TOGETHER = 50
"""Episodes that run side by side: an interruption costs no more than these."""


class Formats(StrEnum):
    lerobot = "lerobot"
    minari = "minari"


def collect(
    task: Annotated[
        str, typer.Argument(help="A task, or a recipe by path or name.", autocompletion=completion.recipes)
    ],
    out: Annotated[
        Path,
        typer.Argument(
            help="New folder; for Minari it ends in a version: ~/.minari/datasets/hand/lift-v0.",
            callback=options.folder,
        ),
    ],
    policy: Annotated[
        str,
        typer.Option(help="Policy file that acts; default: the script.", autocompletion=completion.policies),
    ] = NOTHING,
    format: Annotated[Formats, typer.Option(help="Format of the data set.")] = Formats.lerobot,
    hand: options.TrainedHand = None,
    side: Annotated[str | None, typer.Option(help="right or left; default: the recipe's.")] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Number of episodes.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first episode; each next one adds 1.")] = 0,
    only: Annotated[bool, typer.Option("--only-success", help="Keep successful episodes only.")] = False,
) -> None:
    """Write episodes of an environment as a LeRobot or Minari set."""
    from allegro_twin.errors import ConfigError
    from allegro_twin.files.output_folder import defer_signals
    from allegro_twin.learning.environments.collect import collect_episodes
    from allegro_twin.learning.environments.settings import env_keywords
    from allegro_twin.learning.training.settings import load_recipe
    from allegro_twin.recording.exchange.environment_episodes import to_lerobot, to_minari
    from allegro_twin.surfaces.cli import console

    if any(out.iterdir()):
        raise ConfigError(f"{out}: has files; a data set is written into a new folder, as a whole")
    recipe = load_recipe(task, hand=hand, side=side)
    # Recipes of trainings on a GPU name it; these few episodes need none.
    recipe = recipe.model_copy(update={"environment": recipe.environment.model_copy(update={"device": "cpu"})})
    actor, period, robot = _actor(policy, recipe)
    found: list[EnvironmentEpisode] = []
    keywords, interrupted = env_keywords(recipe.environment), False
    try:
        while len(found) < episodes:
            n = min(TOGETHER, episodes - len(found))
            found += collect_episodes(actor, recipe.task, keywords, n, seed=seed + len(found))
    except KeyboardInterrupt:
        interrupted, left = True, episodes - len(found)
        if not found:
            console.warn("interrupted: no episode is whole yet, and nothing is written: the same command begins anew")
            raise
        console.warn(
            f"interrupted: {len(found)} of {episodes} episodes are whole; the same command with another folder, "
            f"--seed {seed + len(found)} and --episodes {left} collects the rest"
        )
    held = [episode for episode in found if episode.success[-1]]
    kept = held if only else found
    if not kept:
        raise ConfigError(f"none of {len(found)} episodes ended well: leave out --only-success, or take a policy")

    def write(some: Sequence[EnvironmentEpisode]) -> None:
        nonlocal interrupted
        complete = False
        try:
            with defer_signals():
                if format is Formats.minari:
                    to_minari(some, out, period)
                else:
                    to_lerobot(some, out, period, robot)
                complete = True
        except KeyboardInterrupt:
            if not complete:
                raise
            interrupted = True

    written, full = _write_what_fits(kept, write)
    steps = sum(len(episode.action) for episode in written)
    said = f"{out}/: {len(written)} episodes, {steps} steps; {len(held)} of {len(found)} ended well"
    console.console.print(said, soft_wrap=True, highlight=False, markup=False)
    if full is not None:
        first = found.index(kept[len(written)])
        raise RecordingError(
            f"{full}; it has {len(written)} of {len(kept)} episodes: the same command with a folder on another disk, "
            f"--seed {seed + first} and --episodes {episodes - first} collects the rest"
        )
    if interrupted:
        raise typer.Exit(130)


def _write_what_fits(
    kept: Sequence[EnvironmentEpisode], write: Callable[[Sequence[EnvironmentEpisode]], None]
) -> tuple[Sequence[EnvironmentEpisode], RecordingError | None]:
    """Write a data set of all episodes, or of the first ones where the disk takes no more, and the error of that disk.
    Raises RecordingError where it takes none."""
    full, count = None, len(kept)
    while True:
        try:
            write(kept[:count])
            return kept[:count], full
        except RecordingError as error:
            if count == 1 or not isinstance(error.__cause__, OSError):
                raise
            full, count = error, max(1, count * 3 // 4)


def _actor(policy: str, recipe: Recipe) -> tuple[Policy, float, str]:
    """The acting policy, the duration of a step, s, and the name of the hand. Raises ConfigError."""
    from allegro_twin.files.assets import find_file
    from allegro_twin.learning.environments.engine import training_differences
    from allegro_twin.learning.policy.card import check_card
    from allegro_twin.learning.policy.controller import ZeroPolicy
    from allegro_twin.learning.policy.loading import load_policy
    from allegro_twin.learning.tasks import make_task
    from allegro_twin.surfaces.cli import console

    task = make_task(recipe.task, recipe.environment, 1, 1)
    seconds, robot = task.interface.seconds, task.spec.name
    if policy == NOTHING:
        return ZeroPolicy(task.spec.n_joints), seconds, robot
    for line in training_differences(policy, recipe.environment):
        console.warn(line)
    loaded = load_policy(find_file(policy, "policy", "conf/policies", ".onnx"))
    check_card(loaded.card, task.card())
    return loaded.policy, seconds, robot
