"""A mirror for a hand: its observer from its file, and its thresholds from a motion that touched nothing."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from allegro_twin.app.rig import Rig
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.dynamixel.driver.backend import DynamixelBackend
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import find_file, read_yaml
from allegro_twin.hands.description.calibration import HandCalibration, Version, load_wiring
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.loop import to_the_end
from allegro_twin.recording.reader import Recording, load
from allegro_twin.recording.replay import ReplayBackend, samples_of
from allegro_twin.sim.observer.observer import Observer
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.motions.motion import calibration_of
from allegro_twin.twin.identify.results.gap import breaks_away, drive_of
from allegro_twin.twin.identify.results.hand_file import shift
from allegro_twin.twin.mirror.contact_detection import Contact, contacts
from allegro_twin.twin.mirror.fault_detection import Calm
from allegro_twin.twin.mirror.faults import Anomaly
from allegro_twin.twin.mirror.mirror import STOPS, Mirror
from allegro_twin.types import Array, Sample, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Mirrored:
    """What the mirror saw of a recording."""

    t: Vector
    """s, (k,)."""
    disturbance: Array
    """(k, n), N·m."""
    off: Array
    """Reported minus predicted, (k, n), rad."""
    above: Array
    """(k, n), N·m: more was a touch."""
    contacts: tuple[Contact, ...]
    anomaly: Anomaly | None
    unnamed: tuple[str, ...] = ()
    """Names of faults that it could not say."""


def make_mirror(
    spec: HandSpec,
    hand: str,
    version: Version,
    used: HandCalibration,
    period: float,
    calm: Calm | None = None,
    stop: Collection[str] = (),
    gravity: Vector | None = None,
) -> Mirror:
    """Of the hand in a file, or of the nominal one; `used`: with what the host makes rad and N·m of counts; `gravity`:
    in the palm frame, (3,), m/s², where the hand does not report it. Raises ConfigError."""
    _known(stop)
    wiring = load_wiring(spec.model, hand)
    if wiring.version not in (None, version):
        raise ConfigError(f"{hand} is of a {wiring.version} hand, what it is to mirror of a {version} one")
    mine = load_spec(spec.model, spec.side, hand, version)
    own = np.array(wiring.calibration.torque_constant, dtype=float)
    drive = drive_of(mine, own, shift(version, used, wiring.calibration.encoder_offset))
    observer = Observer(spec, drive, period, bristly=breaks_away(mine.drive), noise=noise_in(hand, mine))
    return Mirror(spec, observer, np.array(used.torque_constant, dtype=float), calm, stop, gravity)


def noise_in(hand: str, spec: HandSpec) -> Vector:
    """Standard deviation of reported positions as a hand's file has it, (n,), rad: as `identify` found it, or what its
    encoders are said to add; 0 where it says nothing. Raises ConfigError."""
    found = np.zeros(spec.n_joints)
    if spec.drive is not None:
        found = np.hypot(spec.drive.encoder_noise, spec.drive.quantisation / np.sqrt(12.0))
    table = read_yaml(find_file(hand, "hand", "conf/hands")) if hand else {}
    measured = (table.get("identified") or {}).get("noise")
    if measured is None:
        return found
    try:
        row = np.broadcast_to(np.asarray(measured, dtype=np.float64), (spec.n_joints,))
    except (TypeError, ValueError):
        row = np.full(spec.n_joints, np.nan)
    if not (row >= 0.0).all() or not np.isfinite(row).all():
        raise ConfigError(f"{hand}: identified.noise needs a number of rad from 0 for each of {spec.n_joints} joints")
    return np.maximum(found, row)


def left_out(spec: HandSpec, hand: str) -> str:
    """What a hand's file says that its mirror knows nothing of, as a sentence; nothing where that is nothing."""
    drive = load_spec(spec.model, spec.side, hand or spec.serial).drive
    if drive is None or not drive.backlash.any():
        return ""
    most = 1000.0 * float(np.max(drive.backlash))
    return (
        f"{hand or spec.serial} has up to {most:.1f} mrad of backlash, which a mirror leaves out: a link that swings "
        "through it is a disturbance; take thresholds from --free"
    )


def make_loop_mirror(
    spec: HandSpec, period: float, calm: Calm | None = None, stop: Collection[str] = (), gravity: Vector | None = None
) -> Mirror:
    """Of a hand that closes its own loop: what is driven is compared with what the same loop does in simulation.
    `gravity`: in the palm frame, (3,), m/s², where the hand does not report it. Raises ConfigError."""
    from allegro_twin.sim.observer.loop_observer import LoopObserver

    _known(stop)
    return Mirror(spec, LoopObserver(spec, period), np.ones(spec.n_joints), calm, stop, gravity)


def down(rig: Rig) -> Vector | None:
    """Gravity in the palm of a virtual hand that stands still, (3,), m/s²; None: the hand says it, or nobody does."""
    if not isinstance(rig.driver, DynamixelBackend) or rig.sim is None or rig.trial is not None:
        return None
    turn = rig.sim.data.body("palm_link").xmat.reshape(3, 3)
    return np.asarray(rig.sim.model.opt.gravity @ turn)


def _known(stop: Collection[str]) -> None:
    for name in stop:
        if name not in STOPS:
            raise ConfigError(f"--stop-on: {unknown('event', name, STOPS)}")


def beside(rig: Rig, listen: Callable[[Callable[[Sample], None]], None]) -> Mirror:
    """Of a hand on its bus or line, which sees what `listen` tells. Raises ConfigError for any other hand."""
    if isinstance(rig.driver, DynamixelBackend):
        if (gravity := down(rig)) is None:
            raise ConfigError(f"{rig.spec.name} does not report where down is: allegro-twin mirror takes --gravity")
        made = make_loop_mirror(rig.spec, rig.backend.period, gravity=gravity)
        listen(made.see)
        return made
    if not isinstance(rig.driver, CanBackend):
        raise ConfigError("a simulated hand is its own twin: a mirror is for hands on a bus")
    table = rig.driver.calibration
    used = calibration_of(table)
    made = make_mirror(rig.spec, rig.spec.serial, table["version"], used, rig.backend.period)
    listen(made.see)
    return made


def mirrored(path: Path, hand: str, free: Path | None, gravity: Vector | None = None) -> Mirrored:
    """Play a recording past its mirror. `free`: a recording of the same hand that touched nothing; `gravity`: in the
    palm frame, m/s², where neither hand nor recording says it. Raises HandError."""
    recording = load(path)
    spec, calm = recording.spec, Calm.usual(recording.spec) if free is None else limits(free, hand, gravity)
    t, disturbance, off, _, each, above, _ = _seen(recording, hand, calm, gravity)
    touches = tuple(contacts(t, disturbance, above, spec))
    return Mirrored(t, disturbance, off, above, touches, each.anomaly, each.unnamed)


def limits(free: Path, hand: str, gravity: Vector | None = None) -> Calm:
    """What a free motion does not reach. Raises HandError."""
    recording = load(free)
    _, disturbance, _, moving, each, _, spread = _seen(recording, hand, None, gravity)
    gains = np.array(each.diagnosis.gains).reshape(-1, len(recording.spec.fingers))
    usual = np.median(spread, axis=0)
    disturbance = np.nan_to_num(disturbance) / np.maximum(spread / usual, 1.0)
    return Calm.of(disturbance, moving, each.observer.held, gains, recording.period, recording.spec, usual)


def spec_in(recording: Recording, hand: str) -> HandSpec:
    """A recording's hand; one that closes its own loop with all that its card says, which a recording does not. Raises
    ConfigError for another one's card."""
    spec = recording.spec
    if "torque" in spec.commands:
        return spec
    whole = load_spec(hand or spec.model, spec.side)
    if whole.joints != spec.joints:
        raise ConfigError(f"{recording.path} is of a {spec.name}, and {whole.name} has other joints: say --hand")
    return whole


def mirror_of(recording: Recording, hand: str, calm: Calm | None, gravity: Vector | None) -> Mirror:
    """For a recording's hand as its own file, or another, has it. Raises ConfigError."""
    spec, table = spec_in(recording, hand), recording.meta.get("calibration")
    if "torque" not in spec.commands:
        if gravity is None and "gravity" in recording.meta:
            gravity = np.array(recording.meta["gravity"], dtype=np.float64)
        return make_loop_mirror(spec, recording.period, calm, gravity=gravity)
    if table is None:
        raise ConfigError(
            f"{recording.path} does not say with which torque constant its counts became N·m: record it through the "
            "hand's bus"
        )
    used = calibration_of(table)
    return make_mirror(spec, hand or spec.serial, table["version"], used, recording.period, calm, gravity=gravity)


def _seen(
    recording: Recording, hand: str, calm: Calm | None, gravity: Vector | None
) -> tuple[Vector, Array, Array, NDArray[np.bool_], Mirror, Array, Array]:
    """Row by row: times, disturbances, reported minus predicted, which joints moved; the mirror; and, row by row, what
    was a touch and how far noise alone spreads disturbances."""
    each = mirror_of(recording, hand, calm, gravity)
    t, rows = [], []
    for sample in each.watched(played(recording)):
        latest = each.latest()
        t.append(sample.state.t)
        off = sample.state.position - latest["predicted"]
        rows.append((latest["disturbance"], off, each.moving, each.above, each.observer.spread))
    if len(t) < 2:
        raise ConfigError(f"{recording.path} has one row: a mirror needs a motion")
    disturbance, off, moving, above, spread = (np.array(column) for column in zip(*rows[1:], strict=True))
    return np.array(t[1:]), disturbance, off, moving, each, above, spread


def played(recording: Recording) -> Iterator[Sample]:
    """All that was recorded, row by row."""
    return to_the_end(samples_of(ReplayBackend(recording)))
