"""Records excitations of a config's hand: its pose, what is left to record, and the recording."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from allegro_twin.app.config import RunConfig
from allegro_twin.app.rig import Physics, Rig, assemble
from allegro_twin.backend import HandBackend, PassThroughBackend
from allegro_twin.drivers.can.config import VIRTUAL, CanSettings
from allegro_twin.drivers.dynamixel.config import DynamixelSettings
from allegro_twin.drivers.polled.config import PolledSettings
from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.hands.settings import TaskSettings
from allegro_twin.loop import run, until
from allegro_twin.plugins import BACKENDS
from allegro_twin.recording.reader import Recording, load, read_stream
from allegro_twin.recording.recorder import record
from allegro_twin.sim.settings import SimSettings
from allegro_twin.twin.identify.motions.excitation import APPROACH, Excitation, ExcitationPose, find_pose, rehearse
from allegro_twin.twin.identify.motions.following import unfollowed_joints
from allegro_twin.twin.identify.motions.motion import recorded_calibration
from allegro_twin.types import HandState, Sample, frozen
from allegro_twin.version import __version__

SHORTEST = 4.0  # s. Less is not worth an approach.
MISSING, GAP = 0.09, 10
"""Share of the periods, and how many in a row, that a recording may lack: 8 % where a bus loses a frame in fifty, of
which a report takes four. `identify` bridges one or two, and uses pieces of 0.3 s that lack no more than 15 %."""
_WITHOUT_IMU = ("v1", "v2", "v3")
"""Versions whose firmware reports none."""
_GRAVITY_FROM_IMU = 0.05  # s between two reports of an IMU that tells the hand's pose.


@dataclass(frozen=True, slots=True)
class ExcitationRun:
    """A recording that is still to be made of a pose."""

    pose: ExcitationPose
    seconds: float
    seed: int
    """Seed of the motion in this file."""
    requested_seed: int
    """The seed that the files of this pose share."""
    file: Path


def remaining_run(config: RunConfig, name: str, seconds: float, seed: int, folder: Path) -> ExcitationRun | None:
    """The remaining recording of a pose in a folder: None, all, or the rest of an interrupted one, in a file of its
    own; one that lacks too many periods is recorded anew. Raises ConfigError, as for a folder that was recorded with
    another hand or seed, or that has a file cut before its first whole row, which stays; or RecordingError."""
    hand_pose, recorded_seconds, useless = find_pose(name, config.hand.side), 0.0, list[int]()
    files = numbered_files(name, folder)
    for number, file in files.items():
        recording = _load_partial(file)
        if recording is None:
            continue
        _check_hand(recording, config)
        if (asked := recording.meta.get("excitation", {}).get("asked", seed)) != seed:
            raise ConfigError(
                f"{file} has the motion of seed {asked}, not {seed}: give --seed {asked}, or another --out"
            )
        if describe_loss(recording):
            useless.append(number)
        else:
            recorded_seconds += len(recording) * config.period
    left = seconds - recorded_seconds
    if left < min(SHORTEST, seconds / 2.0):
        return None
    number = useless[0] if useless else max(files, default=0) + 1
    return ExcitationRun(
        hand_pose, max(left, SHORTEST) + APPROACH, seed + 97 * number, seed, folder / f"{name}_{number}.arrow"
    )


def numbered_files(name: str, folder: Path) -> dict[int, Path]:
    """Recordings of a pose by their numbers, in order; a copy with a name of its own is none of them."""
    found = {file: re.fullmatch(rf"{re.escape(name)}_([1-9]\d*)", file.stem) for file in folder.glob("*.arrow")}
    return dict(sorted((int(match[1]), file) for file, match in found.items() if match))


def _load_partial(file: Path) -> Recording | None:
    """What a file holds; None, and the file is gone, for one of a process that ended before its first row. Raises
    ConfigError for what cannot be read, which stays as it is."""
    try:
        stream = read_stream(file) if file.stat().st_size else None
        if stream is None or not (stream.table.num_rows or stream.cut):
            file.unlink()
            return None
        if not stream.table.num_rows:
            raise RecordingError(f"{file} is damaged before its first whole row")
        return load(file, partial=True)
    except RecordingError as error:
        raise ConfigError(f"{error}: move the file out of {file.parent}, or give another --out") from error


def describe_loss(recording: Recording) -> str:
    """How many periods a recording lacks, where it lacks so many that it is of no use; else empty."""
    tick = recording.columns["tick"]
    every, gap = int(tick[-1] - tick[0]) + 1, int(np.diff(tick).max(initial=1)) - 1
    lost = every - len(tick)
    if lost <= MISSING * every and gap <= GAP:
        return ""
    return f"{lost} of {every} periods are missing, up to {gap} in a row"


def describe_unfollowed(recording: Recording) -> list[str]:
    """Joints that did not follow the excitation that was recorded, a sentence each."""
    spec, columns = recording.spec, recording.columns
    found = unfollowed_joints(spec, recording.meta["excitation"], columns["t"], columns["position"])
    return [each.sentence(spec) for each in found]


def _check_hand(recording: Recording, config: RunConfig) -> None:
    """Raise ConfigError for a recording of another hand than the config's."""
    there, hand = recording.meta["hand"], config.hand
    version = recording.meta.get("calibration", {}).get("version")
    its = _hand_of(there["model"], there["side"], version, there["serial"])
    own = _hand_of(hand.model, hand.side, version and getattr(config.backend, "version", version), hand.serial)
    if its != own:
        raise ConfigError(f"{recording.path} is of {its}, and this is {own}: give another folder with -o")


def _hand_of(model: str, side: str, version: str | None, serial: str) -> str:
    """A hand in words; a file of it by its whole path."""
    file = str(Path(serial).resolve()) if serial.endswith(".yaml") else serial
    return " ".join(filter(None, ("a", side, version, model, "hand", file and f"({file})")))


def pose_config(config: RunConfig, hand_pose: ExcitationPose) -> RunConfig:
    """The config with the hand in this pose: a virtual hand is put there; the gravity of a hand on CAN is set, unless
    its IMU reports it. Raises ConfigError for a simulation and for a recording."""
    if isinstance(config.backend, SimSettings) or BACKENDS.kind(config.backend.kind).replays:
        raise ConfigError(f"a {config.backend.kind} hand has no drive to find: `excite` is for hands on a wire")
    alone = config.model_copy(update={"task": TaskSettings()})
    if not isinstance(config.backend, CanSettings):
        return alone
    settings, change = config.backend, dict[str, object]()
    if settings.interface == VIRTUAL:
        alone = served_pose(config, hand_pose)
    reported = settings.imu > 0.0 and settings.gravity is None
    if not reported and settings.interface == VIRTUAL and settings.version not in _WITHOUT_IMU:
        change |= {"imu": _GRAVITY_FROM_IMU, "gravity": None}
    elif not reported:
        change["gravity"] = list(hand_pose.gravity)
    return alone.changed(backend=change)


def _check_drive(rig: Rig) -> None:
    """Raise ConfigError for a hand that takes no torques, or does not say what its torques are."""
    name = rig.spec.name
    if "torque" not in rig.spec.commands:
        raise ConfigError(
            f"{name} has no drive to find: it takes {' and '.join(rig.spec.commands)} commands, no torques"
        )
    if not rig.device.calibration:
        raise ConfigError(
            f"{name} does not say what its torques are: give its backend a `calibration` (docs/contract.md#calibration)"
        )
    recorded_calibration(rig.device.calibration)


def served_pose(config: RunConfig, hand_pose: ExcitationPose) -> RunConfig:
    """The config of a virtual hand that stands in this pose, alone. Raises ConfigError for a hand without a bus or a
    serial port."""
    if not isinstance(config.backend, CanSettings | DynamixelSettings | PolledSettings):
        raise ConfigError(f"a {config.backend.kind} hand is not served: only hands on a bus or a serial port are")
    scene = {} if config.backend.scene is None else config.backend.scene.model_dump(exclude_unset=True)
    scene |= {"kind": "sim", "facing": list(hand_pose.facing), "fingers": list(hand_pose.fingers)}
    return config.model_copy(update={"task": TaskSettings()}).changed(backend={"scene": scene})


def record_run(
    config: RunConfig, job: ExcitationRun, advance: Callable[[float], None], physics: Physics | None = None
) -> Excitation:
    """Rehearse, then play and record. The hand is limp afterwards in any case. `physics`: what stands behind a virtual
    hand. Raises HandError; RecordingError, with the remedy, where what was recorded is of no use."""
    rig = assemble(config, physics)
    with closing(rig.backend):
        _check_drive(rig)
        motion = rehearse(rig.spec, job.pose, job.seed, job.seconds).excitation
        samples = _check_pose(until(job.seconds, run(PosedHand(rig.backend, job.pose), motion)), job.pose)
        for sample in record(samples, job.file, rig.spec, config.period, meta=_meta(rig, config, job, motion)):
            advance(sample.state.t)
    if lost := describe_loss(load(job.file)):
        raise RecordingError(
            f"{job.file} is of no use: {lost}; record it anew on a quieter computer, with the same command"
        )
    return motion


def _check_pose(samples: Iterator[Sample], hand_pose: ExcitationPose) -> Iterator[Sample]:
    """Check the hand's pose before anything moves far."""
    for number, sample in enumerate(samples):
        if number == 0:
            hand_pose.check(sample.state.gravity)
        yield sample


class PosedHand(PassThroughBackend):
    """A hand in a pose, which has the gravity of that pose where it reports none."""

    def __init__(self, backend: HandBackend, hand_pose: ExcitationPose) -> None:
        super().__init__(backend)
        self._gravity = frozen(hand_pose.gravity)

    def reset(self) -> HandState:
        return self._known(super().reset())

    def read(self) -> HandState:
        return self._known(super().read())

    def recover(self) -> HandState:
        return self._known(super().recover())

    def _known(self, state: HandState) -> HandState:
        return state if np.isfinite(state.gravity).all() else replace(state, gravity=self._gravity)


def _meta(rig: Rig, config: RunConfig, job: ExcitationRun, motion: Excitation) -> dict[str, object]:
    found: dict[str, object] = {"allegro_twin": __version__, "config": config.model_dump(mode="json")}
    if rig.sim is not None:
        found |= rig.sim.meta()
    return found | {
        "calibration": dict(rig.device.calibration),
        "excitation": {"pose": job.pose.name, "asked": job.requested_seed, "seed": motion.seed, "scale": motion.scale},
    }
