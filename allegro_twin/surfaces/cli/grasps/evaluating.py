"""The commands that say what grasps are worth, and which of two is better."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import complete, options
from allegro_twin.surfaces.cli.recorded import recordings

if TYPE_CHECKING:
    from allegro_twin.grasping.evaluation.campaign import EvaluationTarget, SamplingSettings, TargetOptions
    from allegro_twin.spec import Side

Targets = Annotated[
    list[str],
    typer.Argument(
        help="Scenarios, folders of them, or .npy files of grasps. Or a policy (.onnx, .zip) and its recipe.",
        autocompletion=complete.targets,
    ),
]
Rules = Annotated[
    str | None,
    typer.Option(help="fc, tabletop, table_pick, hard, strength, or a file.", autocompletion=complete.protocols),
]
Vary = Annotated[str | None, typer.Option(help='As in "position=5,yaw=10,torque=0,friction=0.5-1": mm, degrees, %.')]
OtherGrasp = Annotated[str | None, typer.Option(help="Another than the scenario's.", autocompletion=complete.grasps)]
OtherObject = Annotated[
    str | None,
    typer.Option("--object", help="Of the catalogue, or an .obj or .stl.", autocompletion=complete.objects),
]
Seed = Annotated[int, typer.Option(min=0, help="Of the draws.")]
OwnSeed = Annotated[
    int | None,
    typer.Option(
        min=0,
        help="Of the draws of --uncertainty, 0 by default; of a policy: of its first episode, by default none that a "
        "training has seen.",
    ),
]
Count = Annotated[int | None, typer.Option("--jobs", min=1, help="Processes; by default as many as there are cores.")]


class Sides(StrEnum):
    right = "right"
    left = "left"
    both = "both"


class Engines(StrEnum):
    local = "local"
    ray = "ray"


def register(app: typer.Typer) -> None:
    """Add these commands to the command line."""
    app.command()(evaluate)
    app.command()(compare)


def evaluate(
    targets: Targets,
    protocol: Rules = None,
    uncertainty: Annotated[
        int | None, typer.Option(help="So many draws of what the hand is not told.", callback=options.positive)
    ] = None,
    vary: Vary = None,
    side: Annotated[Sides | None, typer.Option(help="By default as the scenario says.")] = None,
    grasp: OtherGrasp = None,
    thing: OtherObject = None,
    seed: OwnSeed = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for results and a report; what is there goes on.", callback=options.folder),
    ] = None,
    rrd: Annotated[
        recordings.Recorded | None,
        typer.Option(help="Rerun recordings beside the report: of the ends, best and worst of each object, or of all."),
    ] = None,
    engine: Annotated[Engines, typer.Option(help="This computer, or a Ray cluster.")] = Engines.local,
    address: Annotated[str | None, typer.Option(help="Of the cluster, as HOST:PORT.")] = None,
    count: Count = None,
    episodes: Annotated[
        int | None, typer.Option(help="Of a policy, for every set: by default 200.", callback=options.positive)
    ] = None,
    can: Annotated[int | None, typer.Option(help="Of a policy: so many of them over a virtual CAN bus, too.")] = None,
    hand: options.TrainedHand = None,
    film: Annotated[
        Path | None,
        typer.Option(help="Of a policy: an .mp4 of three episodes.", callback=options.file(".mp4", ".mkv")),
    ] = None,
) -> None:
    """Say what grasps are worth: a row for each with its margins, or how often it holds under uncertainty."""
    if _of_policy(targets):
        if side is Sides.both:
            raise ConfigError("a policy is for one side: --side right or left")
        scenarios = {
            "--protocol": protocol, "--uncertainty": uncertainty, "--vary": vary, "--grasp": grasp, "--object": thing,
            "--out": out, "--rrd": rrd, "--address": address, "--jobs": count,
            "--engine": None if engine is Engines.local else engine.value,
        }  # fmt: skip
        _without_use(scenarios, "scenarios", f"{targets[0]} is a policy")
        _policy(targets, 200 if episodes is None else episodes, can or 0, hand, side and side.value, film, seed)
        return
    policies = {"--hand": hand, "--film": film, "--episodes": episodes, "--can": can}
    _without_use(policies, "policies", f"{targets[0]} is a scenario")
    if seed is not None and uncertainty is None:
        raise ConfigError(f"--seed {seed} is for draws: say how many with --uncertainty N")
    from allegro_twin.grasping.evaluation.campaign import TargetOptions, find_targets
    from allegro_twin.surfaces.cli.grasps import verdicts

    if rrd is not None:
        recordings.check(out)
    noise = _noise(uncertainty, vary, seed or 0)
    found = find_targets(_paths(targets), TargetOptions(protocol, _sides(side), grasp, thing))
    chosen = verdicts.engine_of(engine.value, address, count)
    trials = verdicts.tried(found, noise, chosen, out)
    rows = verdicts.told(found, noise, trials, out, rrd)
    if uncertainty is None and not all(row["held"] for row in rows):
        raise typer.Exit(5)


def compare(
    first: Annotated[str, typer.Argument(metavar="A", help="A scenario.", autocompletion=complete.targets)],
    second: Annotated[
        str | None, typer.Argument(metavar="[B]", help="Another, or A again.", autocompletion=complete.targets)
    ] = None,
    grasp: Annotated[str | None, typer.Option(help="Of B.", autocompletion=complete.grasps)] = None,
    uncertainty: Annotated[int, typer.Option(help="Draws, the same for both.", callback=options.positive)] = 50,
    vary: Vary = None,
    protocol: Rules = None,
    side: Annotated[Sides | None, typer.Option(help="right or left; by default as A says.")] = None,
    seed: Seed = 0,
    count: Count = None,
) -> None:
    """Say which of two grasps is better: in the same draws, by the exact McNemar test."""
    from allegro_twin.grasping.evaluation.campaign import TargetOptions, check_one_protocol
    from allegro_twin.grasping.evaluation.outcomes import compare_pairs, row_rate, summarise
    from allegro_twin.grasping.statistics import comparison_text
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.grasps import verdicts

    if second is None and grasp is None:
        raise ConfigError("compare takes two scenarios, or one and --grasp for the other")
    if side is Sides.both:
        raise ConfigError("--side both is no side to compare on: right or left")
    noise = _noise(uncertainty, vary, seed)
    asked = TargetOptions(protocol, _sides(side))
    both = [_single(first, asked), _single(second or first, TargetOptions(protocol, asked.sides, grasp))]
    if both[0].item == both[1].item:
        raise ConfigError(f"{first} and {second or first} are the same grasp on the same object")
    check_one_protocol(both)
    trials = verdicts.tried(both, noise, verdicts.engine_of("local", None, count)).rows
    names = _names(both)
    for name, row in zip(names, summarise(both, trials), strict=True):
        console.console.print(f"{name}: held in {row_rate(row)}", highlight=False)
    console.console.print(comparison_text(compare_pairs(trials), names[0], names[1]), soft_wrap=True, highlight=False)


def _noise(n: int | None, vary: str | None, seed: int) -> SamplingSettings:
    from allegro_twin.grasping.evaluation.campaign import SamplingSettings
    from allegro_twin.surfaces.cli.grasps.variation import varied

    if vary is not None and n is None:
        raise ConfigError("--vary is for draws: say how many with --uncertainty N")
    return SamplingSettings(n or 0, seed, varied(vary or ""))


def _of_policy(targets: list[str]) -> bool:
    named = Path(targets[0]).suffix in (".onnx", ".zip") or targets[0] in complete.policies()
    return named or (len(targets) == 2 and targets[1] in complete.recipes())


def _without_use(given: Mapping[str, object], for_whom: str, but: str) -> None:
    """Raise ConfigError for an option that is given and that nothing here reads."""
    for name, value in given.items():
        if value is not None:
            raise ConfigError(f"{name} {value} is for {for_whom}, and {but}: leave it out")


def _policy(
    targets: list[str],
    episodes: int,
    can: int,
    hand: str | None,
    side: str | None,
    film: Path | None,
    seed: int | None,
) -> None:
    from allegro_twin.surfaces.cli.policies.training import evaluate_policy

    if len(targets) != 2:
        raise ConfigError(f"missing argument or one too many: a policy takes its recipe: evaluate {targets[0]} RECIPE")
    evaluate_policy(targets[0], targets[1], episodes, can, hand, side, film, seed)


def _sides(side: Sides | None) -> tuple[Side, ...] | None:
    from allegro_twin.spec import SIDES

    if side is None:
        return None
    return tuple(each for each in SIDES if side in (Sides.both, each))


def _paths(targets: list[str]) -> list[Path]:
    """Scenarios and files of grasps; what else is in a folder is left out. Raises ConfigError."""
    from allegro_twin.files.assets import read_yaml
    from allegro_twin.surfaces.cli.run.runs import files_of

    found: list[Path] = []
    for target in targets:
        if Path(target).suffix == ".npy":
            found.append(Path(target))
            continue
        npy = sorted(Path(target).rglob("*.npy")) if target and Path(target).is_dir() else []
        files = [] if npy and not any(Path(target).rglob("*.yaml")) else files_of(target)
        scenarios = [file for file in files if {"wrist", "grasps"} & read_yaml(file).keys()]
        if not scenarios and not npy:
            raise ConfigError(f"{target}: no scenario; evaluate takes scenarios, .npy files and folders of them")
        found += scenarios + npy
    return found


def _single(target: str, asked: TargetOptions) -> EvaluationTarget:
    from allegro_twin.grasping.evaluation.campaign import find_targets

    found = find_targets(_paths([target]), asked)
    if len(found) != 1:
        raise ConfigError(f"{target}: {len(found)} grasps; compare takes one on either side")
    return found[0]


def _names(both: list[EvaluationTarget]) -> list[str]:
    """By what they differ in: the scenario, or else the grasp."""
    names = [target.name for target in both]
    return names if names[0] != names[1] else [target.case.grasp.name for target in both]
