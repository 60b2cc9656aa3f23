"""Mirror of the hand of a config."""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np

from allegro_twin.app.rig import Rig
from allegro_twin.drivers.dynamixel.driver.backend import DynamixelBackend
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.calibration import Version
from allegro_twin.recording.replay import ReplayBackend
from allegro_twin.twin.identify.motions.motion import recorded_calibration
from allegro_twin.twin.mirror.factory import make_loop_mirror, make_mirror
from allegro_twin.twin.mirror.fault_detection import Thresholds
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.types import Sample, Vector


def mirror_rig(rig: Rig, listen: Callable[[Callable[[Sample], None]], None]) -> Mirror:
    """Mirror of a hand with its own file, fed by `listen`. Raises ConfigError for a hand that cannot be mirrored."""
    gravity = palm_gravity(rig)
    if isinstance(rig.driver, DynamixelBackend) and gravity is None:
        raise ConfigError(f"{rig.spec.name} does not report where down is: allegro-twin mirror takes --gravity")
    mirror = mirror_of(rig, rig.spec.serial, gravity=gravity)
    listen(mirror.observe)
    return mirror


def mirror_of(
    rig: Rig, hand: str, thresholds: Thresholds | None = None, stop: Collection[str] = (), gravity: Vector | None = None
) -> Mirror:
    """Mirror of a rig's hand. `hand`: its file, empty for the nominal hand; `stop`: events that raise HandFault;
    `gravity`: in the palm frame, (3,), m/s², where the hand does not report it. Raises ConfigError for a hand that
    cannot be mirrored."""
    spec, period = rig.spec, rig.backend.period
    check_mirrored(rig)
    if "torque" not in spec.commands:
        return make_loop_mirror(spec, period, thresholds, stop, gravity)
    table = rig.device.calibration
    used = recorded_calibration(table)
    return make_mirror(spec, hand, table["version"], used, period, thresholds, stop, gravity)


def check_mirrored(rig: Rig) -> None:
    """Raise ConfigError for a simulation in this program, a recording, or a hand that does not say what its torques
    are."""
    if rig.driver is rig.sim or rig.driver is rig.episode:
        raise ConfigError("a simulated hand is its own twin: a mirror is for real and virtual hands, and recordings")
    if isinstance(rig.driver, ReplayBackend):
        raise ConfigError("a replay is mirrored by its recording: allegro-twin mirror RECORDING.arrow")
    if "torque" in rig.spec.commands and not rig.device.calibration:
        raise ConfigError(
            f"{rig.spec.name} does not say what its torques are: give its backend a `calibration` "
            "(docs/contract.md#calibration)"
        )
    if "torque" not in rig.spec.commands and not isinstance(rig.driver, DynamixelBackend):
        raise ConfigError(
            f"{rig.spec.name} closes its own loop: live, those on Dynamixel motors are mirrored; others by a recording"
        )


def wire_version(rig: Rig) -> Version | None:
    """The version of the hand's electronics, where its backend says it."""
    version: Version | None = rig.device.calibration.get("version")
    return version


def palm_gravity(rig: Rig) -> Vector | None:
    """Gravity in the palm of a virtual hand that stands still, (3,), m/s²; None: the hand reports it, or it is
    unknown."""
    if not isinstance(rig.driver, DynamixelBackend) or rig.sim is None or rig.trial is not None:
        return None
    turn = rig.sim.data.body("palm_link").xmat.reshape(3, 3)
    return np.asarray(rig.sim.model.opt.gravity @ turn)
