"""What the command line does, apart from the command line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from allegro_twin.build import Rig, scenario_config
from allegro_twin.config import PolicySettings, RunConfig, load_config
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root, find, read_yaml
from allegro_twin.session import Outputs
from allegro_twin.spec import SIDES


@dataclass(frozen=True, slots=True)
class Job:
    """One run to do."""

    name: str
    config: RunConfig


def configs_of(
    targets: Sequence[str],
    side: str | None,
    seconds: float | None,
    partial: bool,
    grasp: str | None,
    thing: str | None,
    policy: str | None = None,
    goal: str | None = None,
) -> list[Job]:
    """A job for every config, and for every scenario and side; under a policy if one is named. Raises ConfigError."""
    if goal is not None and policy is None:
        raise ConfigError("--goal is for a policy: give --policy, too")
    jobs = []
    for target in targets:
        for path in _files(target):
            if "backend" in read_yaml(path):
                config = _with(load_config(path), side, seconds, partial)
                jobs.append(Job(path.stem, _under(policy, goal, grasp, config)))
                continue
            for each in SIDES if side == "both" else (side,):
                config = _with(scenario_config(path, each, grasp, thing), None, seconds, partial)
                jobs.append(Job(thing or path.stem, _under(policy, goal, None, config)))
    return jobs


def outputs_in(folder: Path, job: Job, rig: Rig, wanted: Outputs) -> Outputs:
    """A recording and a picture in a folder, named after the run."""
    stem = f"{job.name}_{rig.spec.side}" if rig.trial is not None else job.name
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
    from allegro_twin.replay.backend import ReplayBackend, samples_of
    from allegro_twin.replay.recording import load
    from allegro_twin.session import rerun_stage

    recording = load(path, partial=partial)
    total(len(recording))
    viewer_of, shown = rerun_stage()
    from allegro_twin.look.scenery import scenery

    viewer = viewer_of(recording.spec, scenery(recording.spec, recording.meta), view=camera)
    url = viewer.serve(open_browser=True, web_port=port) if web else ""
    if not web:
        viewer.spawn()
    backend = ReplayBackend(recording)
    for _ in shown(samples_of(backend), viewer, backend.extras):
        advance()
    _concluded(viewer, recording)
    viewer.flush()
    return viewer, url


def convert(path: Path, target: Path, *, partial: bool) -> int:
    """Write a recording in the format that the target's suffix names; the number of rows."""
    from allegro_twin.replay.recording import load

    writers: dict[str, Callable[[Any, Path], None]] = {".parquet": _parquet, ".csv": _csv, ".rrd": _rrd}
    if target.suffix not in writers:
        raise ConfigError(unknown("export format", target.suffix, writers))
    recording = load(path, partial=partial)
    writers[target.suffix](recording, target)
    return len(recording)


def from_log(path: Path, target: Path, config: str | None, bus: str | None) -> tuple[int, str]:
    """Make a recording of a bus log; its rows, and what is not as it should be. Raises RecordingError, ConfigError."""
    if config is None:
        raise ConfigError(f"{path}: a bus log does not say whose it is; name a config of that hand with --config")
    from allegro_twin.build.logged import make_recording

    found = make_recording(load_config(config), path, target, bus)
    return found.states, found.summary()


def _parquet(recording: Any, target: Path) -> None:
    from allegro_twin.replay.convert import to_parquet

    to_parquet(recording, target)


def _csv(recording: Any, target: Path) -> None:
    from allegro_twin.replay.convert import to_csv

    to_csv(recording, target)


def _rrd(recording: Any, target: Path) -> None:
    from allegro_twin.replay.backend import ReplayBackend, samples_of
    from allegro_twin.session import rerun_stage

    viewer_of, shown = rerun_stage()
    from allegro_twin.files.whole import whole_file
    from allegro_twin.look.scenery import scenery

    backend = ReplayBackend(recording)
    with whole_file(target) as temporary:
        viewer = viewer_of(recording.spec, scenery(recording.spec, recording.meta)).to_file(temporary)
        with closing(viewer):
            for _ in shown(samples_of(backend), viewer, backend.extras):
                pass
            _concluded(viewer, recording)


def _concluded(viewer: Any, recording: Any) -> None:
    from allegro_twin.evaluate.again import checks, in_words, report_of

    report = report_of(recording.spec, recording.columns, recording.meta)
    if report is not None:
        viewer.conclude(checks(report), in_words(report))


def _files(target: str) -> list[Path]:
    path = Path(target)
    for folder in (path, data_root() / path):
        if folder.is_dir():
            found = sorted(folder.rglob("*.yaml"))
            if not found:
                raise ConfigError(f"{target}: no scenarios in this folder")
            return found
    if path.is_file() or len(path.parts) > 1 or path.suffix:
        return [find(path, "config or scenario", "scenarios")]
    names = {file.stem: file for folder in ("scenarios", "conf") for file in (data_root() / folder).rglob("*.yaml")
             if folder == "scenarios" or file.parent.name == "conf"}  # fmt: skip
    if path.name not in names:
        raise ConfigError(unknown("config or scenario", path.name, names))
    return [names[path.name]]


def _under(policy: str | None, goal: str | None, grasp: str | None, config: RunConfig) -> RunConfig:
    if policy is None:
        return config
    controller = PolicySettings(kind="policy", file=policy, goal=goal, grasp=grasp)
    return config.model_copy(update={"controller": controller})


def _with(config: RunConfig, side: str | None, seconds: float | None, partial: bool) -> RunConfig:
    changes: dict[str, Any] = {}
    if seconds is not None:
        if not seconds > 0:
            raise ConfigError(f"--seconds must be positive, not {seconds}")
        changes["seconds"] = seconds
    if side in SIDES:
        changes["hand"] = config.hand.model_copy(update={"side": side})
    if partial and config.backend.kind == "replay":
        changes["backend"] = config.backend.model_copy(update={"partial": True})
    return config.model_copy(update=changes)
