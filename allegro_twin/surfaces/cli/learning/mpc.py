"""The command `mpc`: a task without learning, by model predictive control."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from allegro_twin.surfaces.cli import completion, options


def mpc(
    task: Annotated[str, typer.Argument(help="A task as it is, or a recipe's.", autocompletion=completion.recipes)],
    episodes: Annotated[int, typer.Option(min=1, help="Number of episodes.")] = 4,
    seconds: Annotated[float | None, typer.Option(help="Of each episode, at most; default: the task's.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first episode; each next one adds 1.")] = 0,
    settings: Annotated[
        Path | None, typer.Option("--settings", help="YAML: method, samples, costs; default: conf/mpc.")
    ] = None,
    hand: options.TrainedHand = None,
    side: Annotated[str | None, typer.Option(help="right or left; default: the recipe's.")] = None,
    film: Annotated[
        Path | None, typer.Option(help="Film of all episodes, .mp4; replaces what is there.", callback=options.film)
    ] = None,
) -> None:
    """Do a task without learning, by model predictive control.

    Interrupted, it prints the episodes that have ended, and a film ends there."""
    from contextlib import ExitStack

    from allegro_twin.errors import ConfigError, RecordingError
    from allegro_twin.files.schema import load_settings
    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.learning.mpc.episodes import MpcEpisode, run_episodes
    from allegro_twin.learning.mpc.settings import MpcSettings, planner_settings
    from allegro_twin.learning.tasks import task_type
    from allegro_twin.learning.training.settings import load_recipe
    from allegro_twin.surfaces.cli import console
    from allegro_twin.viewing.films import check_av, open_film

    if film is not None:
        check_av()
    if seconds is not None and not seconds > 0:
        raise ConfigError(f"--seconds must be positive, not {seconds:g}")
    recipe = load_recipe(task, hand=hand, side=side)
    chosen = planner_settings(recipe.task) if settings is None else load_settings(MpcSettings, settings)
    environment = recipe.environment
    # Physics in steps of the control period, where a hand bears it: three times as fast as those of 1 ms.
    step = load_spec(environment.hand, environment.side).longest_step(environment.period)
    if "timestep" in environment.model_fields_set:
        step = min(environment.timestep, step)
    environment = environment.model_copy(update={"device": "cpu", "state": False, "timestep": step})
    fps = round(1.0 / (environment.period * environment.decimation))
    found: list[MpcEpisode] = []
    unwritten = ""
    with options.interruptible(film, progress=lambda: f"{len(found)} of {episodes} episodes have ended"):
        try:
            with ExitStack() as stack:
                bar = stack.enter_context(console.progress()) if sys.stdout.isatty() else None
                line = None if bar is None else bar.add_task("decisions", total=None)

                def advance(done: int, of: int) -> None:
                    if bar is not None and line is not None:
                        bar.update(line, completed=done, total=of)

                shown = None if film is None else stack.enter_context(open_film(film, fps))
                run_episodes(recipe.task, environment, chosen, episodes, seed=seed, seconds=seconds, shown=shown,
                             advance=advance, ended=found.append,
                             place="" if settings is None else f"{settings}: ")  # fmt: skip
        except RecordingError as error:
            unwritten = str(error)
        finally:
            if found:
                console.console.print(console.mpc_table(found, task_type(recipe.task), chosen, seed))
    if unwritten:
        options.end_unwritten(unwritten)
