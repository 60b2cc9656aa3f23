"""A mirror for a hand: its observer from its file, and its thresholds from a motion that touched nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from allegro_twin.description.calibration import Calibration, Version
from allegro_twin.description.hands import load_spec
from allegro_twin.description.wiring import load_wiring
from allegro_twin.errors import ConfigError
from allegro_twin.identify.gap import drive_of
from allegro_twin.identify.motion import calibration_of
from allegro_twin.identify.stored import shift
from allegro_twin.loop import to_the_end
from allegro_twin.mirror.events import Contact, contacts, thresholds
from allegro_twin.mirror.mirror import Mirror
from allegro_twin.replay.backend import ReplayBackend, samples_of
from allegro_twin.replay.recording import Recording, load
from allegro_twin.sim.observer import Observer
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Sample, Vector

DEFAULT = 0.02
"""N·m, where no free motion says what a touch is."""


@dataclass(frozen=True, slots=True, eq=False)
class Mirrored:
    """What the mirror saw of a recording."""

    t: Vector
    """s, (k,)."""
    disturbance: Array
    """(k, n), N·m."""
    off: Array
    """Reported minus predicted, (k, n), rad."""
    above: Vector
    """(n,), N·m: more is a touch."""
    contacts: tuple[Contact, ...]


def make_mirror(
    spec: HandSpec, hand: str, version: Version, used: Calibration, period: float, above: Vector | None = None
) -> Mirror:
    """Of the hand in a file, or of the nominal one; `used`: with what the host makes rad and N·m of counts. Raises
    ConfigError."""
    wiring = load_wiring(spec.model, hand)
    if wiring.version not in (None, version):
        raise ConfigError(f"{hand} is of a {wiring.version} hand, what it is to mirror of a {version} one")
    mine = load_spec(spec.model, spec.side, hand, version)
    own = np.array(wiring.calibration.torque_constant, dtype=float)
    drive = drive_of(mine, own, shift(version, used, wiring.calibration.encoder_offset))
    bristly = mine.drive is not None and bool(mine.drive.bristle.any())
    observer = Observer(spec, drive, period, bristly=bristly)
    return Mirror(spec, observer, np.array(used.torque_constant, dtype=float), above)


def mirrored(path: Path, hand: str, free: Path | None) -> Mirrored:
    """Play a recording past its mirror. `free`: a recording of the same hand that touched nothing. Raises HandError."""
    t, disturbance, off, spec = _seen(load(path), hand)
    above = np.full(spec.n_joints, DEFAULT) if free is None else limits(free, hand)
    return Mirrored(t, disturbance, off, above, tuple(contacts(t, disturbance, above, spec)))


def limits(free: Path, hand: str) -> Vector:
    """What disturbances of a free motion never reach, (n,), N·m. Raises HandError."""
    recording = load(free)
    return thresholds(_seen(recording, hand)[1], recording.period)


def _seen(recording: Recording, hand: str) -> tuple[Vector, Array, Array, HandSpec]:
    spec, table = recording.spec, recording.meta.get("calibration")
    if table is None:
        raise ConfigError(
            f"{recording.path} does not say with which torque constant its counts became N·m: record it through the "
            "hand's bus"
        )
    each = make_mirror(spec, hand or spec.serial, table["version"], calibration_of(table), recording.period)
    t, disturbance, off = [], [], []
    for sample in each.watched(_samples(recording)):
        latest = each.latest()
        t.append(sample.state.t)
        disturbance.append(latest["disturbance"])
        off.append(sample.state.position - latest["predicted"])
    if len(t) < 2:
        raise ConfigError(f"{recording.path} has one row: a mirror needs a motion")
    return np.array(t[1:]), np.array(disturbance[1:]), np.array(off[1:]), spec


def _samples(recording: Recording) -> Iterator[Sample]:
    return to_the_end(samples_of(ReplayBackend(recording)))
