"""Commands that evaluate grasps and policies, and compare two grasps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import completion, options

if TYPE_CHECKING:
    from allegro_twin.grasping.evaluation.campaign import EvaluationTarget, SamplingSettings, TargetOptions
    from allegro_twin.spec import Side

Targets = Annotated[
    list[str],
    typer.Argument(
        help="Scenarios, folders of them, or .npy files of grasps; or a policy (.onnx, .zip) and its recipe.",
        autocompletion=completion.targets,
    ),
]
Rules = Annotated[
    str | None,
    typer.Option(
        help="Protocol: fc, tabletop, table_pick, hard, strength, or a file.",
        autocompletion=completion.protocols,
        rich_help_panel=options.TRIALS,
    ),
]
Vary = Annotated[
    str | None,
    typer.Option(
        help='Half-widths of the draws, mm, degrees and %: "position=5,yaw=10,torque=0,friction=0.5-1".',
        rich_help_panel=options.TRIALS,
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the draws.", rich_help_panel=options.TRIALS)]
OwnSeed = Annotated[
    int | None,
    typer.Option(
        min=0,
        help="Seed of the draws, default 0; for a policy: seed of its first episode, by default one that no training "
        "uses.",
        rich_help_panel=options.TRIALS,
    ),
]


def evaluate(
    targets: Targets,
    protocol: Rules = None,
    uncertainty: Annotated[
        int | None,
        typer.Option(
            help="Number of draws of pose, size, mass, friction and strength.",
            callback=options.positive,
            rich_help_panel=options.TRIALS,
        ),
    ] = None,
    vary: Vary = None,
    side: Annotated[options.Sides | None, typer.Option(help="Which hand; default: the scenario's.")] = None,
    grasp: options.OtherGrasp = None,
    object_name: options.OtherObject = None,
    seed: OwnSeed = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for results and a page; finished trials in it are not repeated.",
            callback=options.folder,
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    rrd: Annotated[
        options.Recordings | None,
        typer.Option(
            help="Rerun recordings in --out: of the best and worst grasp of each object (ends), or of all.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    engine: Annotated[
        options.Engines, typer.Option(help="This computer, or a Ray cluster.", rich_help_panel=options.COMPUTE)
    ] = options.Engines.local,
    address: Annotated[
        str | None, typer.Option(help="Address of the cluster, HOST:PORT.", rich_help_panel=options.COMPUTE)
    ] = None,
    count: options.Count = None,
    episodes: Annotated[
        int | None,
        typer.Option(
            help="Episodes of a policy for each set of objects; default: 200.",
            callback=options.positive,
            rich_help_panel=options.POLICY,
        ),
    ] = None,
    can: Annotated[
        int | None,
        typer.Option(help="Episodes of a policy that also run over a virtual CAN bus.", rich_help_panel=options.POLICY),
    ] = None,
    hand: Annotated[
        str | None,
        typer.Option(
            help="Model of hand, a card, or one hand's own file; default: as the target says.",
            autocompletion=completion.models,
        ),
    ] = None,
    film: Annotated[
        Path | None,
        typer.Option(
            help="Film three episodes of a policy to this .mp4; replaces it.",
            callback=options.film,
            rich_help_panel=options.POLICY,
        ),
    ] = None,
) -> None:
    """Evaluate grasps or a policy: margins, success rates.

    With a policy and its recipe: the success rate of the policy."""
    if _of_policy(targets):
        if side is options.Sides.both:
            raise ConfigError("a policy is for one side: --side right or left")
        scenarios = {
            "--protocol": protocol, "--uncertainty": uncertainty, "--vary": vary, "--grasp": grasp,
            "--object": object_name, "--out": out, "--rrd": rrd, "--address": address, "--jobs": count,
            "--engine": None if engine is options.Engines.local else engine.value,
        }  # fmt: skip
        _refuse_unused(scenarios, "scenarios", f"{targets[0]} is a policy")
        _policy(targets, 200 if episodes is None else episodes, can or 0, hand, side and side.value, film, seed)
        return
    policies = {"--film": film, "--episodes": episodes, "--can": can}
    _refuse_unused(policies, "policies", f"{targets[0]} is a scenario")
    if seed is not None and uncertainty is None:
        raise ConfigError(f"--seed {seed} is for draws: say how many with --uncertainty N")
    from allegro_twin.grasping.evaluation.campaign import TargetOptions, find_targets
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.grasps import trials
    from allegro_twin.surfaces.cli.hand_override import model_or_file

    if rrd is not None:
        trials.check_recordings(out)
    noise = _noise(uncertainty, vary, seed or 0)
    model, serial = model_or_file(hand)
    wanted = TargetOptions(protocol, _sides(side), grasp, object_name, model, serial)
    found = find_targets(_of_hand(_paths(targets), model), wanted)
    for target in {target.item["file"]: target for target in found if "file" in target.item}.values():
        for line in _said_of(target, named=hand is not None):
            console.warn(line)
    chosen = trials.engine_of(engine.value, address, count)
    results = trials.run_trials(found, noise, chosen, out)
    rows = trials.report_trials(found, noise, results, out, rrd)
    if out is None:
        console.hint("Next: --out FOLDER keeps the results and a page with pictures; --uncertainty 50 adds draws")
    if uncertainty is None and not all(row["held"] for row in rows):
        raise typer.Exit(5)


def _said_of(target: EvaluationTarget, *, named: bool) -> list[str]:
    """Sentences on what a grasp file does not say of its hand, and on what --object replaces. `named`: the hand."""
    from allegro_twin.grasping.interchange.read import assumed_hand, replaced_object

    item = target.item
    said = [assumed_hand(Path(item["file"]), target.spec, named=named)]
    if "object" in item:
        said.append(replaced_object(Path(item["file"]), item["object"], target.spec))
    return said


def _of_hand(paths: list[Path], hand: str | None) -> list[Path]:
    """With scenarios of this model of hand for the same objects. Raises ConfigError if none has one."""
    from allegro_twin.files.assets import read_yaml
    from allegro_twin.surfaces.cli.hand_override import own_scenarios

    scenarios = [path for path in paths if path.suffix != ".npy" and "grasps" not in read_yaml(path)]
    return own_scenarios(scenarios, hand) + [path for path in paths if path not in scenarios]


def compare(
    first: Annotated[str, typer.Argument(metavar="A", help="A scenario.", autocompletion=completion.targets)],
    second: Annotated[
        str | None,
        typer.Argument(
            metavar="[B]", help="Another scenario; default: A, with --grasp.", autocompletion=completion.targets
        ),
    ] = None,
    grasp: Annotated[str | None, typer.Option(help="Grasp of B.", autocompletion=completion.grasps)] = None,
    uncertainty: Annotated[
        int,
        typer.Option(
            help="Number of draws, the same for both.", callback=options.positive, rich_help_panel=options.TRIALS
        ),
    ] = 50,
    vary: Vary = None,
    protocol: Rules = None,
    side: Annotated[Literal["right", "left"] | None, typer.Option(help="Which hand; default: A's.")] = None,
    hand: Annotated[str | None, typer.Option(help="One hand's own file.", autocompletion=completion.hands)] = None,
    seed: Seed = 0,
    count: options.Count = None,
) -> None:
    """Compare two grasps in the same draws (exact McNemar test)."""
    from allegro_twin.grasping.evaluation.campaign import TargetOptions, check_one_protocol
    from allegro_twin.grasping.evaluation.outcomes import compare_pairs, row_rate, summarise
    from allegro_twin.grasping.statistics import comparison_text
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.grasps import trials
    from allegro_twin.surfaces.cli.hand_override import model_or_file

    if second is None and grasp is None:
        raise ConfigError("compare takes two scenarios, or one and --grasp for the other")
    noise = _noise(uncertainty, vary, seed)
    model, serial = model_or_file(hand)
    if model is not None:
        raise ConfigError(f"--hand {hand} is a model of hand, and scenarios are of one: name one hand's own file")
    wanted = TargetOptions(protocol, _sides(side), serial=serial)
    both = [_single(first, wanted), _single(second or first, replace(wanted, grasp=grasp))]
    if both[0].item == both[1].item:
        raise ConfigError(f"{first} and {second or first} are the same grasp on the same object")
    check_one_protocol(both)
    results = trials.run_trials(both, noise, trials.engine_of("local", None, count)).rows
    names = _names(both)
    for name, row in zip(names, summarise(both, results), strict=True):
        console.say(f"{name}: held in {row_rate(row)}")
    console.console.print(comparison_text(compare_pairs(results), names[0], names[1]), soft_wrap=True, highlight=False)


def _noise(n: int | None, vary: str | None, seed: int) -> SamplingSettings:
    from allegro_twin.grasping.evaluation.campaign import SamplingSettings
    from allegro_twin.surfaces.cli.grasps.trials import parse_variation

    if vary is not None and n is None:
        raise ConfigError("--vary is for draws: say how many with --uncertainty N")
    return SamplingSettings(n or 0, seed, parse_variation(vary or ""))


def _of_policy(targets: list[str]) -> bool:
    named = Path(targets[0]).suffix in (".onnx", ".zip") or targets[0] in completion.policies()
    return named or (len(targets) == 2 and targets[1] in completion.recipes())


def _refuse_unused(given: Mapping[str, object], for_whom: str, but: str) -> None:
    """Raise ConfigError for an option that has no use here."""
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
    from allegro_twin.surfaces.cli.learning.train import evaluate_policy

    if len(targets) != 2:
        raise ConfigError(f"missing argument or one too many: a policy takes its recipe: evaluate {targets[0]} RECIPE")
    evaluate_policy(targets[0], targets[1], episodes, can, hand, side, film, seed)


def _sides(side: str | None) -> tuple[Side, ...] | None:
    from allegro_twin.spec import SIDES

    if side is None:
        return None
    return tuple(each for each in SIDES if side in (options.Sides.both, each))


def _paths(targets: list[str]) -> list[Path]:
    """The scenarios and grasp files among the targets; other files in folders are skipped. Raises ConfigError."""
    from allegro_twin.files.assets import read_yaml
    from allegro_twin.surfaces.cli.start.jobs import files_of

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


def _single(target: str, wanted: TargetOptions) -> EvaluationTarget:
    from allegro_twin.grasping.evaluation.campaign import find_targets

    found = find_targets(_paths([target]), wanted)
    if len(found) != 1:
        raise ConfigError(f"{target}: {len(found)} grasps; compare takes one on either side")
    return found[0]


def _names(both: list[EvaluationTarget]) -> list[str]:
    """Names by which two targets differ: the scenario, else the grasp."""
    names = [target.name for target in both]
    return names if names[0] != names[1] else [target.case.grasp.name for target in both]
