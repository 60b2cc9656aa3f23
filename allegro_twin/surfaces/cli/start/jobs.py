"""Jobs of `run`: one configuration for each run, from its arguments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from allegro_twin.app import Rig, scenario_config
from allegro_twin.app.config import RunConfig, check_scenario_side, load_config
from allegro_twin.app.controller_settings import PositionSettings
from allegro_twin.app.session import Outputs
from allegro_twin.app.simulated import following
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root, find_file, read_yaml
from allegro_twin.files.schema import parse_settings
from allegro_twin.spec import SIDES
from allegro_twin.surfaces.cli import options
from allegro_twin.surfaces.cli.hand_override import on_hand, own_scenarios


@dataclass(frozen=True, slots=True)
class RunJob:
    """One run: its name and its configuration."""

    name: str
    config: RunConfig
    cut: bool = False
    """Whether --seconds ends the run."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """The options of `run` beside its targets. None: as the config or the scenario says."""

    side: str | None = None
    hand: str | None = None
    config: str | None = None
    """Config of the hand that performs scenarios."""
    grasp: str | None = None
    object: str | None = None
    policy: str | None = None
    goal: str | None = None
    seconds: float | None = None
    partial: bool = False


def configs_of(targets: Sequence[str], options: RunOptions = RunOptions()) -> list[RunJob]:
    """One job for each config or scenario and each side. Raises ConfigError."""
    jobs = []
    for target in targets:
        for path in _scenarios_for_hand(files_of(target), options):
            scenario = "backend" not in read_yaml(path)
            if options.config is not None and not scenario:
                raise ConfigError(
                    f"--config says which hand performs scenarios; {path} is a config itself: leave one out"
                )
            for side in SIDES if options.side == "both" else (options.side,):
                base = _scenario_config(path, options, side) if scenario else load_config(path)
                config = _apply(on_hand(base, options.hand, side), options)
                name = path.stem if options.object is None or not scenario else Path(options.object).stem
                jobs.append(RunJob(name, config, cut=options.seconds is not None))
    names = [(job.name, job.config.hand.side) for job in jobs]
    for name, hand in names:
        if names.count((name, hand)) > 1:
            raise ConfigError(
                f"{name}, {hand} hand: asked for twice; one report and one recording would replace another"
            )
    return jobs


def _scenarios_for_hand(paths: list[Path], options: RunOptions) -> list[Path]:
    """The files, or the scenarios that another model of hand has for the same objects. Prints which it lacks."""
    if options.grasp is not None or any("backend" in read_yaml(path) for path in paths):
        return paths
    return own_scenarios(paths, options.hand)


def check_folder_outputs(outputs: Outputs) -> None:
    """Raise ConfigError for outputs that a folder has anyway."""
    for name in ("record", "image"):
        if getattr(outputs, name) is not None:
            raise ConfigError(f"--out keeps a recording and a picture of each run: leave out --{name}")


def outputs_in(folder: Path, job: RunJob, rig: Rig, outputs: Outputs) -> Outputs:
    """The outputs of one run in a folder: a recording and a picture, named after the run."""
    stem = f"{job.name}_{rig.spec.side}" if rig.trial is not None else job.name
    return replace(outputs, record=folder / f"{stem}.arrow", image=folder / f"{stem}.png", optional=True)


def files_of(target: str) -> list[Path]:
    """The configs and scenarios of a name, a path or a folder. Raises ConfigError."""
    if not target:
        raise ConfigError("an empty name: give a config, a scenario, or a folder of scenarios")
    path = Path(target)
    for folder in (path, data_root() / path):
        if folder.is_dir():
            # Not the grasps, which stand in a folder beside the scenarios.
            found = sorted(f for f in folder.rglob("*.yaml") if "grasps" not in f.relative_to(folder).parts[:-1])
            if not found:
                raise ConfigError(f"{target}: no scenarios in this folder")
            return found
    if path.is_file() or len(path.parts) > 1 or path.suffix:
        options.refuse_mesh(path)
        return [find_file(path, "config or scenario", "scenarios", below=True)]
    names = {file.stem: file for folder in ("scenarios", "conf") for file in (data_root() / folder).rglob("*.yaml")
             if folder == "scenarios" or file.parent.name == "conf"}  # fmt: skip
    if path.name not in names:
        raise ConfigError(unknown("config or scenario", path.name, names))
    return [names[path.name]]


def _scenario_config(scenario: Path, options: RunOptions, side: str | None) -> RunConfig:
    """A scenario in simulation, or performed by the hand of a config under PD with that config's gains."""
    alone, hand = scenario_config(scenario, side), options.config
    if hand is None:
        return alone
    base = load_config(hand)
    if options.hand is None and options.grasp is None:
        _check_model(scenario, alone.hand.model, hand, base.hand.model)
    if "period" in alone.model_fields_set and alone.period != base.period:
        wanted = f"{scenario}: its protocol wants control every {alone.period} s"
        raise ConfigError(f"{wanted}, {hand} has it every {base.period} s: take one that leaves it open, as table_pick")
    if side is None and "side" in base.hand.model_fields_set:
        check_scenario_side(base, scenario, hand)
    gains = base.controller.gains if isinstance(base.controller, PositionSettings) else None
    controller = following(base.hand, gains)
    task = alone.task.model_dump(exclude_unset=True, exclude_none=True)
    content = base.model_dump(exclude_unset=True, exclude={"task", "seconds"})
    return RunConfig.model_validate(content | {"task": task, "controller": controller})


def _check_model(scenario: Path, wanted: str, config: str, model: str) -> None:
    """Raises ConfigError for a scenario of another model of hand than a config's, with the configs that have it."""
    if Path(wanted).stem == Path(model).stem:
        return
    files = sorted((data_root() / "conf").glob("*.yaml"))
    fitting = [file.stem for file in files if (read := read_yaml(file)).get("hand", {}).get("model") == wanted
               and "backend" in read]  # fmt: skip
    way = f"--config {' or '.join(fitting)}" if fitting else f"a config of its own has hand: {{model: {wanted}}}"
    raise ConfigError(f"{scenario} is for the hand {wanted}; {config} has {model}: {way}, or name a --grasp, too")


def _apply(config: RunConfig, options: RunOptions) -> RunConfig:
    """The config with the task, the policy and the duration of the options. Raises ConfigError."""
    blocks: dict[str, Any] = {}
    task = {key: value for key, value in config.task.model_dump().items() if value is not None}
    if options.policy is not None:
        blocks["controller"] = {"kind": "policy", "file": options.policy}
    if options.policy is not None or options.grasp is not None:
        task.pop("posture", None)  # The option replaces it.
    wanted = {"grasp": options.grasp, "object": options.object, "posture": options.goal}
    task |= {key: value for key, value in wanted.items() if value is not None}
    if options.goal is not None and options.policy is None and config.controller.kind != "policy":
        raise ConfigError("--goal is for a policy: give --policy, too")
    if options.seconds is not None:
        if not options.seconds > 0:
            raise ConfigError(f"--seconds must be positive, not {options.seconds}")
        blocks["seconds"] = options.seconds
    if options.partial:
        if config.backend.kind != "replay":
            raise ConfigError(f"--partial is for recordings; this config has backend {config.backend.kind}")
        blocks["backend"] = config.backend.model_copy(update={"partial": True}).model_dump(exclude_unset=True)
    content = config.model_dump(exclude_unset=True) | blocks | {"task": task}
    return parse_settings(RunConfig, content, "with these options")
