"""Makes mirrors: from a hand's file, for a recording, or for a hand with its own position loop."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import find_file, read_yaml
from allegro_twin.hands.description.calibration import HandCalibration, Version, load_wiring
from allegro_twin.hands.description.specs import is_hand_model, load_spec
from allegro_twin.recording.reader import Recording
from allegro_twin.sim.observer.observer import StateObserver
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.motions.motion import recorded_calibration
from allegro_twin.twin.identify.results.gap import drive_parameters, has_breakaway_friction
from allegro_twin.twin.identify.results.hand_file import offset_shift
from allegro_twin.twin.mirror.fault_detection import Thresholds
from allegro_twin.twin.mirror.mirror import STOPS, Mirror
from allegro_twin.types import Vector


def make_mirror(
    spec: HandSpec,
    hand: str,
    version: Version,
    used: HandCalibration,
    period: float,
    thresholds: Thresholds | None = None,
    stop: Collection[str] = (),
    gravity: Vector | None = None,
) -> Mirror:
    """Mirror of a hand that takes torques, from its file, or of the nominal hand. `used`: calibration with which the
    host converts counts; `gravity`: in the palm frame, (3,), m/s², where the hand does not report it; `stop`: events
    that raise HandFault, of STOPS. Raises ConfigError."""
    _check_stops(stop)
    wiring = load_wiring(spec.model, hand)
    if wiring.version not in (None, version):
        raise ConfigError(f"{hand} is of a {wiring.version} hand, and the hand to mirror is a {version} one")
    mine = load_spec(spec.model, spec.side, hand, version)
    own = np.array(wiring.calibration.torque_constant, dtype=float)
    drive = drive_parameters(mine, own, offset_shift(version, used, wiring.calibration.encoder_offset))
    noise = np.maximum(encoder_noise(hand, mine), make_codec(version).rad_per_count / np.sqrt(12.0))
    observer = StateObserver(spec, drive, period, bristly=has_breakaway_friction(mine.drive), noise=noise)
    return Mirror(spec, observer, np.array(used.torque_constant, dtype=float), thresholds, stop, gravity)


def make_loop_mirror(
    spec: HandSpec,
    period: float,
    thresholds: Thresholds | None = None,
    stop: Collection[str] = (),
    gravity: Vector | None = None,
) -> Mirror:
    """Mirror of a hand that closes its own loop: joint positions are compared with those of the same loop in
    simulation. `gravity`: in the palm frame, (3,), m/s², where the hand does not report it. Raises ConfigError."""
    from allegro_twin.sim.observer.loop_observer import LoopObserver

    _check_stops(stop)
    return Mirror(spec, LoopObserver(spec, period), np.ones(spec.n_joints), thresholds, stop, gravity)


def mirror_for_recording(
    recording: Recording, hand: str, thresholds: Thresholds | None, gravity: Vector | None
) -> Mirror:
    """Mirror for a recording's hand, from its own file or another. Raises ConfigError."""
    spec, table = recorded_spec(recording, hand), recording.meta.get("calibration")
    if "torque" not in spec.commands:
        if gravity is None and "gravity" in recording.meta:
            gravity = np.array(recording.meta["gravity"], dtype=np.float64)
        return make_loop_mirror(spec, recording.period, thresholds, gravity=gravity)
    if table is None:
        raise ConfigError(
            f"{recording.path} does not say with which torque constant its counts became N·m: record it through the "
            "hand's bus, or give its backend a `calibration` (docs/contract.md#calibration)"
        )
    used = recorded_calibration(table)
    return make_mirror(spec, hand or spec.serial, table["version"], used, recording.period, thresholds, gravity=gravity)


def recorded_spec(recording: Recording, hand: str) -> HandSpec:
    """The spec of a recording's hand. For a hand that closes its own loop it comes from the hand's card, which says
    more than a recording. Raises ConfigError for the card of another hand."""
    spec = recording.spec
    if "torque" in spec.commands:
        return spec
    if not hand and not is_hand_model(spec.model):
        raise ConfigError(f"{recording.path} is of the hand {spec.model}, which a card describes: say --hand CARD")
    whole = load_spec(hand or spec.model, spec.side)
    if whole.joints != spec.joints:
        raise ConfigError(f"{recording.path} is of a {spec.name}, and {whole.name} has other joints: say --hand")
    return whole


def encoder_noise(hand: str, spec: HandSpec) -> Vector:
    """Standard deviation of reported positions from a hand's file, (n,), rad: as `identify` found it, or as the
    encoders are specified; 0 where the file says nothing. Raises ConfigError."""
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


def describe_backlash(spec: HandSpec, hand: str) -> str:
    """A sentence on the backlash in a hand's file, which a mirror leaves out; empty without backlash."""
    drive = load_spec(spec.model, spec.side, hand or spec.serial).drive
    if drive is None or not drive.backlash.any():
        return ""
    most = 1000.0 * float(np.max(drive.backlash))
    return (
        f"{hand or spec.serial} has up to {most:.1f} mrad of backlash, which a mirror leaves out: a link that swings "
        "through it is a disturbance; take thresholds from --free"
    )


def _check_stops(stop: Collection[str]) -> None:
    for name in stop:
        if name not in STOPS:
            raise ConfigError(f"--stop-on: {unknown('event', name, STOPS)}")
