"""Commands that plan grasps for an object, and make a first draft of one."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import typer

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.surfaces.cli import completion, options
from allegro_twin.surfaces.cli.grasps.mesh import show_repair

if TYPE_CHECKING:
    from allegro_twin.grasping.plan.search import GraspSearch, SearchBudget
    from allegro_twin.grasping.plan.validate import PlannedGrasp
    from allegro_twin.grasping.scenario import Scenario
    from allegro_twin.spec import HandSpec
    from allegro_twin.sweep.local import SweepEngine


ObjectName = Annotated[
    str,
    typer.Argument(
        metavar="OBJECT", help="A name of the catalogue, or a mesh or scan.", autocompletion=completion.objects
    ),
]
Hull = Annotated[
    bool, typer.Option("--hull", help="Use the convex hull of a mesh, closed or not.", rich_help_panel=options.MESH)
]
Scale = Annotated[
    float | None,
    typer.Option(
        help="Unit of a mesh file, m; default: as its size says.",
        callback=options.positive,
        rich_help_panel=options.MESH,
    ),
]
Hand = Annotated[str, typer.Option(help="Model of hand, or the path of a card.", autocompletion=completion.models)]


def plan(
    object_name: Annotated[
        str,
        typer.Argument(
            metavar="OBJECT", help="A name of the catalogue, or a mesh or scan.", autocompletion=completion.objects
        ),
    ],
    n: Annotated[int, typer.Option("--n", min=1, max=100, help="Number of grasps that differ from each other.")] = 5,
    hand: Hand = options.HAND,
    twin: Annotated[
        str | None,
        typer.Option(
            help="File of one hand, as `identify` writes it: plan for its motors and friction, with draws from its "
            "intervals.",
            autocompletion=completion.hands,
        ),
    ] = None,
    side: Annotated[
        Literal["right", "left"] | None,
        typer.Option(help="Which hand; default: as --twin or the card says, else right."),
    ] = None,
    kind: Annotated[
        str | None, typer.Option("--type", help="Only grasps whose contacts are of this type of the GRASP taxonomy.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder to write into; default: plans/OBJECT. Replaces the plan before, edited or not.",
            callback=options.folder,
        ),
    ] = None,
    keep: Annotated[Path | None, typer.Option(help="Also store the grasps in this folder of your library.")] = None,
    up: Annotated[Literal["x", "y", "z"], typer.Option(help="The object's axis that points up.")] = "z",
    scale: Scale = None,
    mass: Annotated[
        float | None,
        typer.Option(
            help="Mass of a mesh, kg; default: 500 kg/m³.", callback=options.positive, rich_help_panel=options.MESH
        ),
    ] = None,
    friction: Annotated[float, typer.Option(help="Sliding friction, at most 1.", callback=options.positive)] = 0.8,
    hull: Hull = False,
    by: Annotated[
        str | None,
        typer.Option(
            "--by", metavar="REGION", help="Region of the object to hold, m in its own frame: x>0.045,z<0.03."
        ),
    ] = None,
    edge: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="The table ends M in front of the object: push it there first.",
            callback=options.positive,
            rich_help_panel=options.TRIALS,
        ),
    ] = None,
    protocol: Annotated[
        str, typer.Option(help="table_pick; or fc: in the air, pushed along six axes.", rich_help_panel=options.TRIALS)
    ] = "table_pick",
    seconds: Annotated[
        float | None,
        typer.Option(
            "--time",
            help="Budget of the search, CPU-s; default: 120. Judging comes on top.",
            callback=options.positive,
            rich_help_panel=options.TRIALS,
        ),
    ] = None,
    candidates: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Budget of the search, candidates closed in physics; repeats exactly.",
            rich_help_panel=options.TRIALS,
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search.", rich_help_panel=options.TRIALS)] = 0,
    seeds: Annotated[
        int,
        typer.Option(min=1, help="Number of parallel searches, from this seed on.", rich_help_panel=options.COMPUTE),
    ] = 1,
    engine: Annotated[
        options.Engines,
        typer.Option(help="Where they run: this computer, or a Ray cluster.", rich_help_panel=options.COMPUTE),
    ] = options.Engines.local,
    address: Annotated[
        str | None, typer.Option(help="Address of the cluster, HOST:PORT.", rich_help_panel=options.COMPUTE)
    ] = None,
    pictures: Annotated[bool, typer.Option(help="Make a picture of each grasp, and an overview.")] = True,
) -> None:
    """Find grasps for an object, validated in simulated trials."""
    from allegro_twin.files.output_folder import lock_folder
    from allegro_twin.grasping.plan.own_hand import PlannedHand, twin_to_plan_for
    from allegro_twin.grasping.plan.pushing import with_push
    from allegro_twin.grasping.plan.region import parse_region
    from allegro_twin.grasping.plan.save import check_names, check_store
    from allegro_twin.grasping.plan.search import GraspSearch, SearchBudget
    from allegro_twin.grasping.plan.templates import grasp_templates
    from allegro_twin.grasping.plan.validate import SEARCHED
    from allegro_twin.grasping.scenario import load_protocol
    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.grasps.trials import engine_of
    from allegro_twin.surfaces.cli.hand_override import model_or_file

    chosen = engine_of(engine.value, address, None)
    if own_file := model_or_file(hand)[1]:
        raise ConfigError(f"--hand {hand} is one hand's own file, and --hand names its model: say --twin {own_file}")
    own = PlannedHand(load_spec(hand, side), SEARCHED) if twin is None else twin_to_plan_for(hand, twin, side)
    console.warn(own.note)
    spec = own.spec
    scenario = scenario_of(object_name, up, scale, mass, friction, hull=hull).model_copy(
        update={"protocol": protocol, "hand": hand, "side": spec.side}
    )
    name = scenario.objects[0].name
    check_names(name, n)
    if keep is not None:
        check_store(name, n, keep)
    if load_protocol(protocol).floating and edge is not None:
        raise ConfigError(f"--edge is of a table; under {protocol} there is none")
    search = GraspSearch(
        scenario,
        spec,
        grasp_templates(spec, kind),
        seed=seed,
        region=None if by is None else parse_region(by),
        kind=kind,
        uncertainty=own.uncertainty,
    )
    if edge is not None:
        search.scenario = with_push(scenario.model_copy(update={"edge": edge}), spec)
    unlimited = candidates is not None and seconds is None
    budget = SearchBudget(candidates or math.inf, math.inf if unlimited else seconds or 120.0)
    parallel = None if seeds == 1 and engine is options.Engines.local else _Parallel(seeds, chosen.engine)
    with ExitStack() as stack:
        folder = out or Path("plans") / name
        if out is None:
            stack.enter_context(lock_folder(folder))
        paths = _plan_into(folder, search, n, budget, parallel, keep, own.judged)
        if pictures and not search.interrupted:
            _add_pictures(paths, search.scenario, folder, hull=hull)
    console.say(f"In {folder}/: a scenario each. Play one: allegro-twin run {shlex.quote(str(paths[0]))}")
    if search.interrupted:
        raise typer.Exit(130)


class _Parallel(NamedTuple):
    """Searches side by side."""

    seeds: int
    engine: SweepEngine


def _plan_into(
    folder: Path, search: GraspSearch, n: int, budget: SearchBudget, parallel: _Parallel | None, keep: Path | None,
    judged: HandSpec | None,
) -> list[Path]:  # fmt: skip
    """Search, judge, print and write, in a folder that is known to take what is found before the search begins.
    Returns the scenarios."""
    from allegro_twin.files.output_folder import files_changed_by_hand
    from allegro_twin.grasping.plan.save import describe, make_proof, save_grasps, store_grasp, written_out
    from allegro_twin.surfaces.cli import console

    scenario, spec = search.scenario, search.spec
    name = scenario.objects[0].name
    with options.run_folder(folder) as staging:
        if changed := files_changed_by_hand(folder):
            files = ", ".join(map(str, changed))
            console.warn(f"{files}: changed since the plan before, and replaced by what this one finds")
        found = _found(search, n, budget, parallel, judged or spec)
        try:
            made = save_grasps(found, name, staging, spec, search.uncertainty, read_in=folder)
        except RecordingError:
            for path, text in written_out(found, name, folder, spec, search.uncertainty):
                console.console.print(f"# {path}\n{text}", soft_wrap=True, highlight=False, markup=False)
            raise
        paths = [folder / path.relative_to(staging) for path in made]
    for number, planned in enumerate(found, 1):
        if keep is not None:
            kept = f"{name}_{number}"
            store_grasp(planned.grasp, kept, keep / f"{kept}.yaml", spec, describe(planned, spec), evidence=kept,
                   proof=make_proof(planned, search.uncertainty))  # fmt: skip
    return paths


def _found(
    search: GraspSearch, n: int, budget: SearchBudget, parallel: _Parallel | None, judged: HandSpec
) -> list[PlannedGrasp]:
    """The grasps that the search finds, judged with a hand and printed; where Ctrl-C ends it, those that it had by
    then. Exits where there are none."""
    from allegro_twin.grasping.plan.validate import judge_planned
    from allegro_twin.surfaces.cli import console

    name = search.scenario.objects[0].name
    found: list[PlannedGrasp] = []
    try:
        if parallel is None:
            found = _search(search, n, budget)
        else:
            found = _search_parallel(search, n, budget, parallel)
        if found and not search.interrupted:
            if parallel is not None or not math.isnan(search.whole):
                console.errors.print(judging(search, len(found)), soft_wrap=True, highlight=False)
            judge_planned(found, judged, search.uncertainty, search.seed, search.folder)
    except KeyboardInterrupt:
        search.interrupted = True
    if search.interrupted:
        console.warn(interrupted_search(search, found, n))
    console.warn(restless(search))
    if found:
        console.console.print(console.plan_table(name, found, n))
    elif search.interrupted:
        raise typer.Exit(130)
    console.console.print(
        console.search_summary(search, 1 if parallel is None else parallel.seeds, found), soft_wrap=True
    )
    if not found:
        why = search_failure(search) if search.ends else alternatives(search)
        console.errors.print(f"no grasp holds {name}: {why}", soft_wrap=True, highlight=False)
        raise typer.Exit(5)
    return found


def judging(search: GraspSearch, found: int) -> str:
    """What comes after a search, and about how long it takes, in a sentence."""
    from allegro_twin.grasping.plan.validate import JUDGED

    takes = "" if math.isnan(search.whole) else f", up to about {found * JUDGED * search.whole:.0f} CPU-s"
    return f"the search is over: {found} grasp{'s'[: found != 1]}; each is now judged on {JUDGED} fresh draws{takes}"


def interrupted_search(search: GraspSearch, found: Sequence[PlannedGrasp], n: int) -> str:
    """What an interrupted search has, in a sentence."""
    if not found:
        closed = f"after {search.closed} candidates " if search.closed else ""
        return f"interrupted {closed}before a grasp had held the whole trial: nothing is written"
    judged = sum(each.judged > 0 for each in found)
    return f"interrupted: {len(found)} of {n} grasps had held the whole trial, {judged} of them judged on fresh draws"


def restless(search: GraspSearch) -> str:
    """A sentence where joints move too fast in more than a tenth of the draws; empty where they do not."""
    fast, draws = search.drawn["too fast"], search.drawn["draws"]
    if fast <= draws / 10:
        return ""
    known = math.isfinite(search.spec.coarsest_step)
    remedy = "" if known else "; its physics may be shaken by steps of 3 ms: try `coarsest_step: 0.001` in its card"
    return f"in {fast} of {draws} draws a joint moved faster than it may, and the trial was stopped{remedy}"


def search_failure(search: GraspSearch) -> str:
    """Where the candidates of a search were lost, each of them once, and what to do about it."""
    ends = search.ends
    if pushed := ends["pushed out"]:
        lost = [f"{pushed} were pushed out of the hand", *_amiss(ends)]
        return f"{'; '.join(lost)}; the budget ended the search: give it more --time, or --candidates"
    words = {
        "empty": "while closing, for they touched nothing", "unbalanced": "while closing, by a grip that slides off",
        "diverged": "to physics that diverged", "lift": "in the lift", "turn": "in the turn",
    }  # fmt: skip
    lost = [f"{ends[where]} {how}" for where, how in words.items() if ends[where]]
    total, passed = sum(ends[where] for where in (*words, "passed")), ends["passed"]
    said = f"of {total} candidates that physics closed, " + (f"{', '.join(lost)} were lost; " if lost else "")
    said += f"{passed} {'was' if passed == 1 else 'were'} lifted and turned"
    if passed:
        whole = sum(ends[where] for where in ("whole trial", "elsewhere", "other type"))
        others = [f"{ends['whole trial']} dropped it"] if ends["whole trial"] else []
        others += _amiss(ends)
        tried = f"squeezed in several ways each, {whole} ways came through draws to the whole trial"
        said += f"; {tried}" + (f", where {', '.join(others)}" if whole else "")
    return f"{said}; the budget ended the search: give it more --time, or --candidates"


def _amiss(ends: Mapping[str, int]) -> list[str]:
    words = {"elsewhere": "held it elsewhere than by --by", "other type": "held it as another type than --type"}
    return [f"{ends[where]} {how}" for where, how in words.items() if ends.get(where)]


def alternatives(search: GraspSearch) -> str:
    """What is said where no pre-shape goes round an object, with the ways out that were not taken."""
    from allegro_twin.grasping.scenario import load_protocol

    scenario, ways = search.scenario, ["another --hand"]
    if scenario.push is None and not load_protocol(scenario.protocol).floating:
        ways.insert(0, "--edge M, to push it over the table's edge first")
    ways += ["another --by"] * (search.region is not None) + ["another --type"] * (search.kind is not None)
    return f"no pre-shape goes round it: too large, too flat or too small for the hand; try {', or '.join(ways)}"


def _search(search: GraspSearch, n: int, budget: SearchBudget) -> list[PlannedGrasp]:
    """Search on all processors of this computer."""
    from allegro_twin.surfaces.cli import console

    name = search.scenario.objects[0].name
    with console.progress() as bar:
        task = bar.add_task(f"{name}: 0 of {n}", total=1.0)
        return search.run(
            n, budget, lambda best, at: bar.update(task, completed=at, description=f"{name}: {len(best)} of {n}")
        )


def _search_parallel(search: GraspSearch, n: int, budget: SearchBudget, parallel: _Parallel) -> list[PlannedGrasp]:
    """Search with several seeds, one on each processor."""
    from allegro_twin.grasping.plan.parallel import search_in_parallel
    from allegro_twin.surfaces.cli import console

    seeds = parallel.seeds
    with console.progress() as bar:
        task = bar.add_task(f"{search.scenario.objects[0].name}: {seeds} searches", total=seeds)
        return search_in_parallel(
            search, n, budget, seeds, parallel.engine, lambda done, _total: bar.update(task, completed=done)
        )


def new(
    object_name: ObjectName,
    hand: Hand = options.HAND,
    out: Annotated[
        Path,
        typer.Option(
            help="Folder to write into. Replaces an earlier draft for the object, edited or not.",
            callback=options.folder,
        ),
    ] = Path("mine"),
    up: Annotated[Literal["x", "y", "z"], typer.Option(help="The object's axis that points up.")] = "z",
    scale: Scale = None,
    mass: Annotated[
        float | None,
        typer.Option(
            help="Mass of a mesh, kg; default: 500 kg/m³.", callback=options.positive, rich_help_panel=options.MESH
        ),
    ] = None,
    friction: Annotated[float, typer.Option(help="Sliding friction, at most 1.", callback=options.positive)] = 0.8,
    hull: Hull = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the guess.")] = 0,
    picture: Annotated[bool, typer.Option(help="Make a picture of its trial.")] = True,
) -> None:
    """Write a draft of a scenario and a grasp, to edit.

    The palm touches neither object nor table, and the fingers close. Nothing tests whether it holds; `plan` does."""
    from allegro_twin.files.output_folder import defer_signals
    from allegro_twin.grasping.plan.draft import first_guess
    from allegro_twin.grasping.plan.save import save_grasp
    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.surfaces.cli import console

    spec, scenario = load_spec(hand), scenario_of(object_name, up, scale, mass, friction, hull=hull)
    guessed, grasp = first_guess(scenario, spec, seed=seed)
    name = scenario.objects[0].name
    with defer_signals():
        (out / f"{name}_new.png").unlink(missing_ok=True)  # The picture of an earlier draft.
        path = save_grasp(guessed, grasp, f"{name}_new", out, spec, f"A first guess for {name}; not tried yet")
    if picture:
        show_repair(scenario.objects[0].file, scenario.objects[0].scale, out, hull=hull)
        _make_pictures([path], out)
    console.console.print(
        f"Wrote {path} and {out}/grasps/{name}_new.yaml; try it: allegro-twin run {shlex.quote(str(path))}",
        soft_wrap=True,
    )


def scenario_of(
    object_name: str,
    up: Literal["x", "y", "z"],
    scale: float | None,
    mass: float | None,
    friction: float,
    *,
    hull: bool = False,
) -> Scenario:
    """A scenario with the object on the table; the palm is a placeholder. A mesh is named as files may be, after its
    own. Raises ConfigError."""
    from allegro_twin.grasping.scenario import Scenario, parse_object
    from allegro_twin.hands.library.entry_files import name_from
    from allegro_twin.surfaces.cli import console

    if not friction <= 1.0:
        raise ConfigError(f"--friction is at most 1, not {friction}")
    placed = parse_object(object_name)
    changed: dict[str, object] = {"up": up}
    if placed.file is not None:
        changed |= {"scale": scale} | ({} if mass is None else {"mass": mass})
        changed |= {"collision": "hull"} if hull else {}
        changed["name"] = name_from(placed.name, object_name)
        if changed["name"] != placed.name:
            console.warn(f"{object_name}: its grasps and files are named {changed['name']}")
    elif scale is not None or mass is not None:
        raise ConfigError(f"--scale and --mass are for meshes; {object_name} is of the catalogue")
    elif hull:
        raise ConfigError(f"--hull is for meshes; {object_name} is of the catalogue")
    placed = type(placed).model_validate(placed.model_dump() | changed)
    anywhere = {"position": (0, 0, 0.2), "facing": (0, 0, -1), "fingers": (1, 0, 0), "retreat": (0, 0, 0.1)}
    return Scenario.model_validate(
        {"objects": [placed.model_dump()], "friction": friction, "grasp": "planned", "wrist": anywhere}
    )


def _add_pictures(paths: list[Path], scenario: Scenario, folder: Path, *, hull: bool) -> None:
    """Pictures of the trials and of a mesh's repair, counted among the files of a plan."""
    from allegro_twin.files.output_folder import add_to_run

    scenario_object = scenario.objects[0]
    add_to_run(
        folder,
        [*show_repair(scenario_object.file, scenario_object.scale, folder, hull=hull), *_make_pictures(paths, folder)],
    )


def _make_pictures(paths: list[Path], folder: Path) -> list[Path]:
    """Make a strip of pictures for each trial, and one sheet of them. Returns the files."""
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
            outcome = perform(assemble(config), config, Outputs(image=picture, optional=True))
            if outcome.unwritten:
                raise RecordingError(outcome.unwritten)
            for note in outcome.notes:
                console.warn(f"{path.stem}: {note}")
            bar.advance(task)
            if picture.exists():
                strips[path.stem] = picture
    if not strips:
        return []
    overview(strips, folder / "overview.png", columns=min(len(strips), 6))
    return [*strips.values(), folder / "overview.png"]
