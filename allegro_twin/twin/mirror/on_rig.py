"""Mirror of the hand of a config."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from allegro_twin.app.rig import Rig
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.dynamixel.driver.backend import DynamixelBackend
from allegro_twin.errors import ConfigError
from allegro_twin.twin.identify.motions.motion import recorded_calibration
from allegro_twin.twin.mirror.factory import make_loop_mirror, make_mirror
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.types import Sample, Vector


def mirror_rig(rig: Rig, listen: Callable[[Callable[[Sample], None]], None]) -> Mirror:
    """Mirror of a hand on its bus or line, fed by `listen`. Raises ConfigError for any other hand."""
    if isinstance(rig.driver, DynamixelBackend):
        if (gravity := palm_gravity(rig)) is None:
            raise ConfigError(f"{rig.spec.name} does not report where down is: allegro-twin mirror takes --gravity")
        mirror = make_loop_mirror(rig.spec, rig.backend.period, gravity=gravity)
        listen(mirror.observe)
        return mirror
    if not isinstance(rig.driver, CanBackend):
        raise ConfigError("a simulated hand is its own twin: a mirror is for hands on a bus")
    table = rig.driver.calibration
    used = recorded_calibration(table)
    mirror = make_mirror(rig.spec, rig.spec.serial, table["version"], used, rig.backend.period)
    listen(mirror.observe)
    return mirror


def palm_gravity(rig: Rig) -> Vector | None:
    """Gravity in the palm of a virtual hand that stands still, (3,), m/s²; None: the hand reports it, or it is
    unknown."""
    if not isinstance(rig.driver, DynamixelBackend) or rig.sim is None or rig.trial is not None:
        return None
    turn = rig.sim.data.body("palm_link").xmat.reshape(3, 3)
    return np.asarray(rig.sim.model.opt.gravity @ turn)
