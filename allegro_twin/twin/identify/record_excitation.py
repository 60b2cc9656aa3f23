"""Excitations on a config's hand: how it must lie, what is left to record, and the recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from allegro_twin.app.config import RunConfig
from allegro_twin.app.rig import Rig, assemble
from allegro_twin.drivers.can.config import VIRTUAL, CanSettings
from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.hands.settings import TaskSettings
from allegro_twin.loop import run, until
from allegro_twin.recording.reader import load
from allegro_twin.recording.recorder import recorded
from allegro_twin.twin.identify.motions.excitation import APPROACH, Excitation, Pose, pose, rehearsed
from allegro_twin.types import Sample
from allegro_twin.version import __version__

SHORTEST = 4.0  # s. Less is not worth an approach.
_GRAVITY_FROM_IMU = 0.05  # s between two reports of an IMU that is to tell how the hand lies.


@dataclass(frozen=True, slots=True)
class Task:
    """One pose, and what of it is still to be recorded."""

    pose: Pose
    seconds: float
    seed: int
    """Of the motion in this file."""
    asked: int
    """The seed that the files of this pose share."""
    file: Path


def task_of(config: RunConfig, name: str, seconds: float, seed: int, folder: Path) -> Task | None:
    """What is left of a pose in a folder: nothing, all, or the rest of what was interrupted, in a file of its own.
    Raises ConfigError, as for a folder that was recorded with another seed, or RecordingError."""
    lie, there, files = pose(name, config.hand.side), 0.0, sorted(folder.glob(f"{name}_*.arrow"))
    for file in files:
        try:
            recording = load(file, partial=True)
        except RecordingError:
            file.unlink()  # Nothing was written into it yet.
            continue
        if (asked := recording.meta.get("excitation", {}).get("asked", seed)) != seed:
            raise ConfigError(
                f"{file} has the motion of seed {asked}, not {seed}: give --seed {asked}, or another --out"
            )
        there += len(recording) * config.period
    left = seconds - there
    if left < min(SHORTEST, seconds / 2.0):
        return None
    number = max((int(file.stem.rpartition("_")[2]) for file in files), default=0) + 1
    return Task(lie, max(left, SHORTEST) + APPROACH, seed + 97 * number, seed, folder / f"{name}_{number}.arrow")


def laid(config: RunConfig, lie: Pose) -> RunConfig:
    """The config with the hand lying so: a virtual one is put there, of another it is said, unless its IMU says it.
    Raises ConfigError for what is not on a bus."""
    if not isinstance(config.backend, CanSettings):
        raise ConfigError(
            f"a {config.backend.kind} hand has no drive to find: `excite` is for hands on a bus, real or virtual"
        )
    settings, change = config.backend, dict[str, object]()
    if settings.interface == VIRTUAL:
        scene = {} if settings.scene is None else settings.scene.model_dump(exclude_unset=True)
        scene |= {"kind": "sim", "facing": list(lie.facing), "fingers": list(lie.fingers)}
        change["scene"] = scene
    told = settings.imu > 0.0 and settings.gravity is None
    if not told and settings.interface != VIRTUAL:
        change["gravity"] = list(lie.gravity)
    elif not told:
        change |= {"imu": _GRAVITY_FROM_IMU, "gravity": None}
    return config.model_copy(update={"task": TaskSettings()}).changed(backend=change)


def play(config: RunConfig, todo: Task, advance: Callable[[float], None]) -> Excitation:
    """Rehearse, then play and record. The hand is limp afterwards, whatever happens. Raises HandError."""
    rig = assemble(config)
    with closing(rig.backend):
        motion = rehearsed(rig.spec, todo.pose, todo.seed, todo.seconds).excitation
        samples = _checked(until(todo.seconds, run(rig.backend, motion)), todo.pose)
        for sample in recorded(samples, todo.file, rig.spec, config.period, meta=_meta(rig, config, todo, motion)):
            advance(sample.state.t)
    return motion


def _checked(samples: Iterator[Sample], lie: Pose) -> Iterator[Sample]:
    """Before anything moves far: whether the hand lies as it should."""
    for number, sample in enumerate(samples):
        if number == 0:
            lie.check(sample.state.gravity)
        yield sample


def _meta(rig: Rig, config: RunConfig, todo: Task, motion: Excitation) -> dict[str, object]:
    found: dict[str, object] = {"allegro_twin": __version__, "config": config.model_dump(mode="json")}
    if rig.sim is not None:
        found |= rig.sim.meta()
    return found | {
        "calibration": dict(rig.device.calibration),
        "excitation": {"pose": todo.pose.name, "asked": todo.asked, "seed": motion.seed, "scale": motion.scale},
    }
