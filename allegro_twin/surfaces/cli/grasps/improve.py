"""The command `improve`: a local search around a grasp."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import completion, options

if TYPE_CHECKING:
    from allegro_twin.grasping.plan.improve import GraspImprovement, ImprovementResult
    from allegro_twin.grasping.scenario import Scenario
    from allegro_twin.hands.library.grasps import Grasp
    from allegro_twin.spec import HandSpec, Side


def improve(
    scenario: Annotated[str, typer.Argument(help="A scenario, by path or name.", autocompletion=completion.targets)],
    grasp: Annotated[
        str | None, typer.Option(help="Start from this grasp, not the scenario's.", autocompletion=completion.grasps)
    ] = None,
    object_name: Annotated[
        str | None,
        typer.Option("--object", help="Use this object, not the scenario's first.", autocompletion=completion.objects),
    ] = None,
    hand: Annotated[
        str | None,
        typer.Option(help="One hand's own file: improve for its motors and drive.", autocompletion=completion.hands),
    ] = None,
    side: Annotated[
        Literal["right", "left"] | None, typer.Option(help="Which hand; default: as --hand says, else the scenario.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder to write into.", callback=options.folder)] = Path("improved"),
    rounds: Annotated[
        int, typer.Option(min=0, max=50, help="Rounds of variations around the best.", rich_help_panel=options.TRIALS)
    ] = 3,
    population: Annotated[
        int, typer.Option(min=1, max=1000, help="Variations in a round.", rich_help_panel=options.TRIALS)
    ] = 16,
    draws: Annotated[
        int, typer.Option(min=1, max=1000, help="Draws for each variation.", rich_help_panel=options.TRIALS)
    ] = 8,
    unseen: Annotated[
        int, typer.Option(min=1, help="Fresh draws that compare before and after.", rich_help_panel=options.TRIALS)
    ] = 40,
    sustained: Annotated[
        float | None,
        typer.Option(min=0.05, max=1.0, help="Share of its torque limit that a joint may sustain."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search.", rich_help_panel=options.TRIALS)] = 0,
    engine: Annotated[
        options.Engines,
        typer.Option(help="Where trials run: this computer, or a Ray cluster.", rich_help_panel=options.COMPUTE),
    ] = options.Engines.local,
    address: Annotated[
        str | None, typer.Option(help="Address of the cluster, HOST:PORT.", rich_help_panel=options.COMPUTE)
    ] = None,
) -> None:
    """Improve a grasp: vary wrist, postures and squeeze.

    Before and after are compared on draws that the search did not see; what holds fewer of them is not written."""
    from allegro_twin.files.output_folder import defer_signals
    from allegro_twin.grasping.plan.improve import GraspImprovement
    from allegro_twin.grasping.plan.save import save_grasp
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.grasps.trials import engine_of

    if not rounds and sustained is None:
        raise ConfigError("--rounds 0 changes nothing: search for 1 round or more, or say --sustained")
    ended = 0

    def tell(number: int) -> None:
        nonlocal ended
        ended = number

    told = options.interruptible(
        otherwise="nothing is compared or written", progress=lambda: f"{ended} of {rounds} rounds had ended"
    )
    with told:
        settings, begun, spec, path = _load_start(scenario, grasp, object_name, _own_spec(scenario, hand, side))
        chosen = engine_of(engine.value, address, 1 if engine is options.Engines.local else None)
        search = GraspImprovement(
            settings, begun, spec, path.parent, seed, rounds=rounds, population=population, draws=draws, unseen=unseen,
            sustained=math.inf if sustained is None else sustained, engine=chosen.engine, at_once=chosen.at_once,
        )  # fmt: skip
        better = _search(search, path.stem, tell)
    description = _print_comparison(better, unseen, path.stem, begun.name)
    pair = better.comparison
    if not better.found or (sustained is None and pair.only_second < pair.only_first):
        what = "holds fewer fresh draws than before" if better.found else "is the one it began with"
        console.say(
            f"Nothing is written: the best version {what}; more --rounds or --draws, or another --seed, look on"
        )
        raise typer.Exit(5)
    with defer_signals():  # Grasp and scenario must be of one search.
        where = save_grasp(better.after.scenario, better.after.grasp, f"{path.stem}_improved", out, spec, description)
    console.say(f"Play it: allegro-twin run {shlex.quote(str(where))}")


def _own_spec(scenario: str, hand: str | None, side: Side | None) -> HandSpec:
    """The scenario's hand, on its side or another, or one hand of that model by its own file. Raises ConfigError."""
    from allegro_twin.grasping.scenario import load_scenario
    from allegro_twin.hands.description.specs import hand_side, load_spec
    from allegro_twin.surfaces.cli.hand_override import model_or_file

    settings, _ = load_scenario(scenario)
    model, serial = model_or_file(hand)
    if model is not None:
        raise ConfigError(f"--hand {hand} is a model of hand, and {scenario} is of one: name one hand's own file")
    return load_spec(settings.hand, side or (hand_side(serial) if serial else None) or settings.side, serial)


def _load_start(
    scenario: str, grasp: str | None, object_name: str | None, spec: HandSpec
) -> tuple[Scenario, Grasp, HandSpec, Path]:
    """The scenario, the grasp to start from, the hand and the scenario's file. Raises ConfigError."""
    from allegro_twin.grasping.scenario import load_scenario_for
    from allegro_twin.hands.library.entries import LatchGrip

    settings, path, begun = load_scenario_for(scenario, spec, grasp=grasp, object_name=object_name)
    settings = settings.model_copy(update={"side": spec.side})
    if not isinstance(begun.grip, LatchGrip | None):
        raise ConfigError(f"grasp {begun.name} controls force; improve takes grasps that control position")
    return settings, begun, spec, path


def _search(search: GraspImprovement, name: str, ended: Callable[[int], None]) -> ImprovementResult:
    """Search with a progress bar; `ended` gets how many rounds have ended."""
    from allegro_twin.surfaces.cli import console

    with console.progress() as bar:
        task = bar.add_task(name, total=search.rounds)

        def tell(number: int, share: float) -> None:
            ended(number + 1)
            bar.update(task, completed=number + 1, description=f"{share:.0%}")

        return search.run(tell)


def _print_comparison(better: ImprovementResult, unseen: int, name: str, begun: str) -> str:
    """Print before and after. Returns a description for the file."""
    from allegro_twin.grasping.statistics import comparison_text, wilson
    from allegro_twin.surfaces.cli import console

    pair = better.comparison
    before, after = pair.both + pair.only_first, pair.both + pair.only_second
    for which, held in (("before", before), ("after", after)):
        low, high = wilson(held, unseen)
        console.say(f"{which:6s} held {held} of {unseen} draws ({low:.0%} to {high:.0%})")
    console.console.print(comparison_text(pair, "before", "after"), soft_wrap=True)
    (hot, much), (cool, less) = better.hottest
    console.say(f"sustained by the hottest joint: before {much:.0%} ({hot}), after {less:.0%} ({cool})")
    return f"{name}, improved: held in {after} of {unseen} draws, {begun} in {before}"
