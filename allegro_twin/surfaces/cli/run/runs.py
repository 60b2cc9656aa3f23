"""What the command line does, apart from the command line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from allegro_twin.app import Rig, scenario_config
from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.app.controller_settings import PositionSettings
from allegro_twin.app.session import Outputs
from allegro_twin.app.simulated import following
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root, find_file, read_yaml
from allegro_twin.files.schema import parse_settings
from allegro_twin.spec import SIDES
from allegro_twin.surfaces.cli import console
from allegro_twin.surfaces.cli.performers import on_hand, own_scenarios


@dataclass(frozen=True, slots=True)
class Job:
    """One run to do."""

    name: str
    config: RunConfig
    cut: bool = False
    """Whether the command line says when it ends."""


@dataclass(frozen=True, slots=True)
class Options:
    """What the command line says beside its targets; None: what the config or the scenario says."""

    side: str | None = None
    hand: str | None = None
    config: str | None = None
    """The hand that performs scenarios."""
    grasp: str | None = None
    object: str | None = None
    policy: str | None = None
    goal: str | None = None
    seconds: float | None = None
    partial: bool = False


def configs_of(targets: Sequence[str], options: Options = Options()) -> list[Job]:
    """A job for every config or scenario, and each side that is asked for. Raises ConfigError."""
    jobs = []
    for target in targets:
        for path in _performed(files_of(target), options):
            scenario = "backend" not in read_yaml(path)
            if options.config is not None and not scenario:
                raise ConfigError(
                    f"--config says which hand performs scenarios; {path} is a config itself: leave one out"
                )
            for side in SIDES if options.side == "both" else (options.side,):
                base = _performing(path, options.config, side) if scenario else load_config(path)
                config = _with(on_hand(base, options.hand, side), options)
                name = path.stem if options.object is None or not scenario else Path(options.object).stem
                jobs.append(Job(name, config, cut=options.seconds is not None))
    names = [(job.name, job.config.hand.side) for job in jobs]
    for name, hand in names:
        if names.count((name, hand)) > 1:
            raise ConfigError(
                f"{name}, {hand} hand: asked for twice; one report and one recording would replace another"
            )
    return jobs


def _performed(paths: list[Path], options: Options) -> list[Path]:
    """The files themselves, or what another model of hand has in their place; says what it has nothing for."""
    if options.grasp is not None or any("backend" in read_yaml(path) for path in paths):
        return paths
    found, missing = own_scenarios(paths, options.hand)
    if missing:
        console.console.print(f"{options.hand} has no grasp of its own for {', '.join(missing)}", soft_wrap=True)
    return found


def outputs_in(folder: Path, job: Job, rig: Rig, wanted: Outputs) -> Outputs:
    """A recording and a picture in a folder, named after the run."""
    stem = f"{job.name}_{rig.spec.side}" if rig.trial is not None else job.name
    for name in ("record", "image"):
        if getattr(wanted, name) is not None:
            raise ConfigError(f"--out keeps a recording and a picture of each run: leave out --{name}")
    return replace(wanted, record=folder / f"{stem}.arrow", image=folder / f"{stem}.png")


def show(
    path: Path,
    *,
    web: bool,
    port: int,
    partial: bool,
    camera: str,
    total: Callable[[int], None],
    advance: Callable[[], None],
) -> tuple[Any, str]:
    """Play a recording into a Rerun viewer. The viewer, whose page lives as long as it, and the page's address."""
    from allegro_twin.app.session import rerun_stage
    from allegro_twin.recording.reader import load
    from allegro_twin.recording.replay import ReplayBackend, replay_samples

    recording = load(path, partial=partial)
    total(len(recording))
    viewer_of, shown = rerun_stage()
    from allegro_twin.viewing.scenery import scenery

    viewer = viewer_of(recording.spec, scenery(recording.spec, recording.meta), view=camera)
    url = viewer.serve(open_browser=True, web_port=port) if web else ""
    if not web:
        viewer.spawn()
    backend = ReplayBackend(recording)
    for _ in shown(replay_samples(backend), viewer, backend.extras):
        advance()
    _concluded(viewer, recording)
    viewer.flush()
    return viewer, url


def convert(path: Path, target: Path, *, partial: bool, track: str | None = None) -> int:
    """Write a recording in the format that the target's suffix names; the number of rows."""
    from allegro_twin.recording.reader import load
    from allegro_twin.surfaces.cli.run import cells

    writers: dict[str, Callable[[Any, Path], None]] = {".parquet": _parquet, ".csv": _csv, ".rrd": _rrd, ".mcap": _mcap}
    if target.suffix not in writers:
        raise ConfigError(unknown("export format", target.suffix, writers))
    cell = cells.recording_in(path)
    if cell is not None and track is None and target.suffix == ".rrd":
        return cells.to_rrd(cell, target, partial=partial)
    recording = load(cell or path, partial=partial, track=track)
    writers[target.suffix](recording, target)
    return len(recording)


def from_log(path: Path, target: Path, config: str | None, bus: str | None) -> tuple[int, str]:
    """Make a recording of a bus log; its rows, and what is not as it should be. Raises RecordingError, ConfigError."""
    if config is None:
        raise ConfigError(f"{path}: a bus log does not say whose it is; name a config of that hand with --config")
    from allegro_twin.app.bus_log import make_recording

    found = make_recording(load_config(config), path, target, bus)
    return found.states, found.summary()


def _mcap(recording: Any, target: Path) -> None:
    from allegro_twin.recording.exchange.rosbag import to_mcap

    to_mcap(recording, target)


def _parquet(recording: Any, target: Path) -> None:
    from allegro_twin.recording.exchange.tables import to_parquet

    to_parquet(recording, target)


def _csv(recording: Any, target: Path) -> None:
    from allegro_twin.recording.exchange.tables import to_csv

    to_csv(recording, target)


def _rrd(recording: Any, target: Path) -> None:
    from allegro_twin.app.session import rerun_stage
    from allegro_twin.recording.replay import ReplayBackend, replay_samples

    viewer_of, shown = rerun_stage()
    from allegro_twin.files.atomic_write import atomic_file
    from allegro_twin.viewing.scenery import scenery

    backend = ReplayBackend(recording)
    with atomic_file(target) as temporary:
        viewer = viewer_of(recording.spec, scenery(recording.spec, recording.meta)).to_file(temporary)
        with closing(viewer):
            for _ in shown(replay_samples(backend), viewer, backend.extras):
                pass
            _concluded(viewer, recording)


def _concluded(viewer: Any, recording: Any) -> None:
    from allegro_twin.grasping.evaluation.rejudge import phase_results, rejudge, report_markdown

    report = rejudge(recording.spec, recording.columns, recording.meta)
    if report is not None:
        viewer.conclude(phase_results(report), report_markdown(report))


def files_of(target: str) -> list[Path]:
    """The configs and scenarios of a name, a path or a folder. Raises ConfigError."""
    if not target:
        raise ConfigError("an empty name: give a config, a scenario, or a folder of scenarios")
    path = Path(target)
    for folder in (path, data_root() / path):
        if folder.is_dir():
            # Grasps that scenarios name stand in a folder beside them.
            found = sorted(f for f in folder.rglob("*.yaml") if "grasps" not in f.relative_to(folder).parts[:-1])
            if not found:
                raise ConfigError(f"{target}: no scenarios in this folder")
            return found
    if path.is_file() or len(path.parts) > 1 or path.suffix:
        return [find_file(path, "config or scenario", "scenarios", below=True)]
    names = {file.stem: file for folder in ("scenarios", "conf") for file in (data_root() / folder).rglob("*.yaml")
             if folder == "scenarios" or file.parent.name == "conf"}  # fmt: skip
    if path.name not in names:
        raise ConfigError(unknown("config or scenario", path.name, names))
    return [names[path.name]]


def _performing(scenario: Path, hand: str | None, side: str | None) -> RunConfig:
    """A scenario, performed in simulation or by the hand of a config, under PD with that config's gains."""
    alone = scenario_config(scenario, side)
    if hand is None:
        return alone
    base = load_config(hand)
    if "period" in alone.model_fields_set and alone.period != base.period:
        wanted = f"{scenario}: its protocol wants control every {alone.period} s"
        raise ConfigError(f"{wanted}, {hand} has it every {base.period} s: take one that leaves it open, as table_pick")
    gains = base.controller.gains if isinstance(base.controller, PositionSettings) else None
    controller = following(base.hand, gains)
    task = alone.task.model_dump(exclude_unset=True, exclude_none=True)
    content = base.model_dump(exclude_unset=True, exclude={"task", "seconds"})
    return RunConfig.model_validate(content | {"task": task, "controller": controller})


def _with(config: RunConfig, options: Options) -> RunConfig:
    """The config with the task, the policy and the time that the options ask for."""
    blocks: dict[str, Any] = {}
    task = {key: value for key, value in config.task.model_dump().items() if value is not None}
    if options.policy is not None:
        blocks["controller"] = {"kind": "policy", "file": options.policy}
    if options.policy is not None or options.grasp is not None:
        task.pop("posture", None)  # Something else is asked for.
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
