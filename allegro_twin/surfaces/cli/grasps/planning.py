"""The commands that find grasps, and begin one of your own."""

from __future__ import annotations

import math
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.hands.library.entries import HAND
from allegro_twin.surfaces.cli import complete, options
from allegro_twin.surfaces.cli.grasps.evaluating import Engines

if TYPE_CHECKING:
    from allegro_twin.grasping.plan.search import GraspSearch, SearchBudget
    from allegro_twin.grasping.plan.validate import PlannedGrasp
    from allegro_twin.grasping.scenario import Scenario
    from allegro_twin.sweep.local import SweepEngine


Thing = Annotated[
    str, typer.Argument(metavar="OBJECT", help="A name of the catalogue, or a mesh.", autocompletion=complete.objects)
]
Hull = Annotated[bool, typer.Option("--hull", help="Take a mesh's convex hull, as of one whose surface is not closed.")]
Hand = Annotated[str, typer.Option(help="The model of hand, or a card's path.", autocompletion=complete.models)]


def register(app: typer.Typer) -> None:
    """Add these commands to the command line."""
    app.command()(plan)
    app.command()(new)


def plan(
    thing: Annotated[
        str,
        typer.Argument(metavar="OBJECT", help="A name of the catalogue, or a mesh.", autocompletion=complete.objects),
    ],
    n: Annotated[int, typer.Option("--n", min=1, max=100, help="How many grasps that are apart from each other.")] = 5,
    hand: Hand = HAND,
    kind: Annotated[
        str | None, typer.Option("--type", help="Only what its contacts show to be of this type of the GRASP taxonomy.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Where to write; plans/OBJECT otherwise.", callback=options.folder)
    ] = None,
    keep: Annotated[Path | None, typer.Option(help="Store the grasps in this folder of your library, too.")] = None,
    up: Annotated[Literal["x", "y", "z"], typer.Option(help="Which of the object's axes points at the sky.")] = "z",
    scale: Annotated[float, typer.Option(help="Of a mesh: its file's unit in m.", callback=options.positive)] = 1.0,
    mass: Annotated[
        float | None, typer.Option(help="kg; of the catalogue, or 500 kg/m³.", callback=options.positive)
    ] = None,
    friction: Annotated[float, typer.Option(help="Sliding.", callback=options.positive)] = 0.8,
    hull: Hull = False,
    by: Annotated[
        str | None, typer.Option("--by", metavar="REGION", help="Hold it there, m in its own frame: x>0.045,z<0.03.")
    ] = None,
    protocol: Annotated[
        str, typer.Option(help="table_pick; or fc: free in the air, pushed along six axes.")
    ] = "table_pick",
    seconds: Annotated[
        float | None,
        typer.Option(
            "--time",
            help="To search at most, CPU seconds of all processors together; 120 otherwise.",
            callback=options.positive,
        ),
    ] = None,
    candidates: Annotated[
        int | None, typer.Option(min=1, help="To search at most, closed in physics; the same seed finds the same.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Another seed finds other grasps.")] = 0,
    seeds: Annotated[int, typer.Option(min=1, help="So many searches side by side, from this seed on.")] = 1,
    engine: Annotated[Engines, typer.Option(help="Where they run: this computer, or a Ray cluster.")] = Engines.local,
    address: Annotated[str | None, typer.Option(help="Of the cluster, as HOST:PORT.")] = None,
    pictures: Annotated[bool, typer.Option(help="Of every grasp, and an overview.")] = True,
) -> None:
    """Find grasps for an object that stands on a table: proposed by geometry, closed in physics, tried under draws of
    what the hand is not told, and proven in the whole trial."""
    from allegro_twin.files.output_folder import add_to_run, lock_folder, write_run
    from allegro_twin.grasping.plan.region import parse_region
    from allegro_twin.grasping.plan.save import describe, make_proof, save_grasps, store_grasp
    from allegro_twin.grasping.plan.search import GraspSearch, SearchBudget
    from allegro_twin.grasping.plan.templates import grasp_templates
    from allegro_twin.grasping.plan.validate import judge_planned
    from allegro_twin.grasping.scenario import load_protocol
    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.grasps.verdicts import engine_of

    chosen, spec = engine_of(engine.value, address, None), load_spec(hand)
    scenario = scenario_of(thing, up, scale, mass, friction, hull=hull).model_copy(
        update={"protocol": protocol, "hand": hand}
    )
    load_protocol(protocol)
    search = GraspSearch(
        scenario,
        spec,
        grasp_templates(spec, kind),
        seed=seed,
        region=None if by is None else parse_region(by),
        kind=kind,
    )
    name = scenario.objects[0].name
    unlimited = candidates is not None and seconds is None
    budget = SearchBudget(candidates or math.inf, math.inf if unlimited else seconds or 120.0)
    if seeds == 1 and engine is Engines.local:
        found = _searched(search, n, budget)
    else:
        found = _spread(search, n, budget, seeds, chosen.engine)
    judge_planned(found, spec, search.uncertainty, seed, search.folder)
    console.console.print(console.planned(name, found))
    console.console.print(console.searched(search, seeds), soft_wrap=True)
    if not found:
        ends = ", ".join(f"{count} {where}" for where, count in search.ends.most_common())
        console.errors.print(f"no grasp holds {name}: of the candidates that physics closed ended {ends}")
        raise typer.Exit(5)
    with ExitStack() as stack:
        folder = out or Path("plans") / name
        if out is None:
            stack.enter_context(lock_folder(folder))
        with write_run(folder) as staging:
            made = save_grasps(found, name, staging, spec, search.uncertainty, read_in=folder)
            paths = [folder / path.relative_to(staging) for path in made]
        for number, planned in enumerate(found, 1):
            if keep is not None:
                kept = f"{name}_{number}"
                store_grasp(planned.grasp, kept, keep / f"{kept}.yaml", spec, describe(planned), evidence=kept,
                       proof=make_proof(planned, search.uncertainty))  # fmt: skip
        if pictures:
            add_to_run(folder, _pictured(paths, folder))
    console.console.print(f"In {folder}/: a scenario each. Play one: allegro-twin run {paths[0]}", soft_wrap=True)


def _searched(search: GraspSearch, n: int, budget: SearchBudget) -> list[PlannedGrasp]:
    """On all processors of this computer."""
    from allegro_twin.surfaces.cli import console

    name = search.scenario.objects[0].name
    with console.progress() as bar:
        task = bar.add_task(f"{name}: 0 of {n}", total=1.0)
        return search.run(
            n, budget, lambda best, at: bar.update(task, completed=at, description=f"{name}: {len(best)} of {n}")
        )


def _spread(search: GraspSearch, n: int, budget: SearchBudget, seeds: int, engine: SweepEngine) -> list[PlannedGrasp]:
    """One search a processor."""
    from allegro_twin.grasping.plan.parallel import search_in_parallel
    from allegro_twin.surfaces.cli import console

    with console.progress() as bar:
        task = bar.add_task(f"{search.scenario.objects[0].name}: {seeds} searches", total=seeds)
        return search_in_parallel(
            search, n, budget, seeds, engine, lambda done, _total: bar.update(task, completed=done)
        )


def new(
    thing: Thing,
    hand: Hand = HAND,
    out: Annotated[Path, typer.Option(help="Where to write.", callback=options.folder)] = Path("mine"),
    up: Annotated[Literal["x", "y", "z"], typer.Option(help="Which of the object's axes points at the sky.")] = "z",
    scale: Annotated[float, typer.Option(help="Of a mesh: its file's unit in m.", callback=options.positive)] = 1.0,
    mass: Annotated[
        float | None, typer.Option(help="kg, of a mesh; 500 kg/m³ otherwise.", callback=options.positive)
    ] = None,
    friction: Annotated[float, typer.Option(help="Sliding.", callback=options.positive)] = 0.8,
    hull: Hull = False,
    seed: Annotated[int, typer.Option(min=0, help="Another seed proposes another palm.")] = 0,
    picture: Annotated[bool, typer.Option(help="Of the trial that it makes.")] = True,
) -> None:
    """Begin a scenario and a grasp of your own: a palm that is free of object and table, and fingers that close.

    Nothing says yet that it holds; `plan` looks for those that do."""
    from allegro_twin.files.output_folder import defer_signals
    from allegro_twin.grasping.plan.initial_guess import first_guess
    from allegro_twin.grasping.plan.save import save_grasp
    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.surfaces.cli import console

    spec, scenario = load_spec(hand), scenario_of(thing, up, scale, mass, friction, hull=hull)
    guessed, grasp = first_guess(scenario, spec, seed=seed)
    name = scenario.objects[0].name
    with defer_signals():
        (out / f"{name}_new.png").unlink(missing_ok=True)  # Of another guess.
        path = save_grasp(guessed, grasp, f"{name}_new", out, spec, f"A first guess for {name}; not tried yet")
    if picture:
        _pictured([path], out)
    console.console.print(
        f"Wrote {path} and {out}/grasps/{name}_new.yaml; try it: allegro-twin run {path}", soft_wrap=True
    )


def scenario_of(
    thing: str,
    up: Literal["x", "y", "z"],
    scale: float,
    mass: float | None,
    friction: float,
    *,
    hull: bool = False,
) -> Scenario:
    """An object on the table before a hand that is still anywhere. Raises ConfigError."""
    from allegro_twin.grasping.scenario import Scenario, parse_object

    if not friction <= 1.0:
        raise ConfigError(f"--friction is at most 1, not {friction}")
    placed = parse_object(thing)
    changed: dict[str, object] = {"up": up}
    if placed.file is not None:
        changed |= {"scale": scale} | ({} if mass is None else {"mass": mass})
        changed |= {"collision": "hull"} if hull else {}
    elif scale != 1.0 or mass is not None:
        raise ConfigError(f"--scale and --mass are for meshes; {thing} is of the catalogue")
    elif hull:
        raise ConfigError(f"--hull is for meshes; {thing} is of the catalogue")
    placed = type(placed).model_validate(placed.model_dump() | changed)
    anywhere = {"position": (0, 0, 0.2), "facing": (0, 0, -1), "fingers": (1, 0, 0), "retreat": (0, 0, 0.1)}
    return Scenario.model_validate(
        {"objects": [placed.model_dump()], "friction": friction, "grasp": "planned", "wrist": anywhere}
    )


def _pictured(paths: list[Path], folder: Path) -> list[Path]:
    """Make a strip of every trial, and one sheet of them; the files."""
    from allegro_twin.app import assemble, scenario_config
    from allegro_twin.app.session import Outputs, perform
    from allegro_twin.surfaces.cli import console
    from allegro_twin.viewing.stills import overview

    strips = {}
    with console.progress() as bar:
        task = bar.add_task("pictures", total=len(paths))
        for path in paths:
            picture = path.with_suffix(".png")
            config = scenario_config(path)
            for note in perform(assemble(config), config, Outputs(image=picture)).notes:
                console.errors.print(f"[yellow]{path.stem}: {note}[/]")
            bar.advance(task)
            if picture.exists():
                strips[path.stem] = picture
    if not strips:
        return []
    overview(strips, folder / "overview.png", columns=min(len(strips), 6))
    return [*strips.values(), folder / "overview.png"]
