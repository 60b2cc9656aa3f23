"""The command that makes a grasp better where it is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import complete, options
from allegro_twin.surfaces.cli.grasps.evaluating import Engines

if TYPE_CHECKING:
    from allegro_twin.grasping.plan.improve import GraspImprovement, ImprovementResult
    from allegro_twin.grasping.scenario import Scenario
    from allegro_twin.hands.library.grasps import Grasp
    from allegro_twin.spec import HandSpec


def register(app: typer.Typer) -> None:
    """Add this command to the command line."""
    app.command()(improve)


def improve(
    scenario: Annotated[str, typer.Argument(help="A scenario by path or name.", autocompletion=complete.targets)],
    grasp: Annotated[str | None, typer.Option(help="Begin with another grasp.", autocompletion=complete.grasps)] = None,
    thing: Annotated[
        str | None, typer.Option("--object", help="For another object.", autocompletion=complete.objects)
    ] = None,
    out: Annotated[Path, typer.Option(help="Where to write.", callback=options.folder)] = Path("improved"),
    rounds: Annotated[int, typer.Option(min=1, max=50, help="Of variations around the best so far.")] = 3,
    population: Annotated[int, typer.Option(min=1, max=1000, help="Variations a round.")] = 16,
    draws: Annotated[int, typer.Option(min=1, max=1000, help="Of what the hand is not told, for each.")] = 8,
    unseen: Annotated[int, typer.Option(min=1, help="Other draws, on which before and after are compared.")] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Another seed looks elsewhere.")] = 0,
    engine: Annotated[Engines, typer.Option(help="Where trials run: this computer, or a Ray cluster.")] = Engines.local,
    address: Annotated[str | None, typer.Option(help="Of the cluster, as HOST:PORT.")] = None,
) -> None:
    """Make a grasp hold more often where it is: wrist, postures and squeeze, judged on draws that it was not chosen
    on."""
    from allegro_twin.files.output_folder import defer_signals
    from allegro_twin.grasping.plan.improve import GraspImprovement
    from allegro_twin.grasping.plan.save import save_grasp
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.grasps.verdicts import engine_of

    settings, begun, spec, path = _begun(scenario, grasp, thing)
    chosen = engine_of(engine.value, address, 1 if engine is Engines.local else None)
    search = GraspImprovement(
        settings, begun, spec, path.parent, seed, rounds=rounds, population=population, draws=draws, unseen=unseen,
        engine=chosen.engine, at_once=chosen.at_once,
    )  # fmt: skip
    better = _searched(search, path.stem)
    told = _told(better, unseen, path.stem, begun.name)
    with defer_signals():  # A grasp of one search in a scenario of another would be neither's.
        where = save_grasp(better.after.scenario, better.after.grasp, f"{path.stem}_improved", out, spec, told)
    console.console.print(f"Play it: allegro-twin run {where}", soft_wrap=True)


def _begun(scenario: str, grasp: str | None, thing: str | None) -> tuple[Scenario, Grasp, HandSpec, Path]:
    """What there is, and its file. Raises ConfigError."""
    from allegro_twin.grasping.scenario import load_scenario, parse_object
    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.hands.library.library import load_grasp

    settings, path = load_scenario(scenario)
    spec = load_spec(settings.hand)
    if thing is not None:
        settings = settings.model_copy(update={"objects": (parse_object(thing), *settings.objects[1:])})
    begun = load_grasp(grasp or settings.grasp, spec)
    if begun.grip is not None:
        raise ConfigError(f"grasp {begun.name} controls force; improve takes grasps that control position")
    return settings, begun, spec, path


def _searched(search: GraspImprovement, name: str) -> ImprovementResult:
    from allegro_twin.surfaces.cli import console

    with console.progress() as bar:
        task = bar.add_task(name, total=search.rounds)
        return search.run(lambda number, share: bar.update(task, completed=number + 1, description=f"{share:.0%}"))


def _told(better: ImprovementResult, unseen: int, name: str, begun: str) -> str:
    """Show before and after; in a sentence, for the file."""
    from allegro_twin.grasping.statistics import comparison_text, wilson
    from allegro_twin.surfaces.cli import console

    pair = better.comparison
    before, after = pair.both + pair.only_first, pair.both + pair.only_second
    for which, held in (("before", before), ("after", after)):
        low, high = wilson(held, unseen)
        console.console.print(f"{which:6s} held {held} of {unseen} draws ({low:.0%} to {high:.0%})")
    console.console.print(comparison_text(pair, "before", "after"), soft_wrap=True)
    return f"{name}, improved: held in {after} of {unseen} draws, {begun} in {before}"
