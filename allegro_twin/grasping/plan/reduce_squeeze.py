"""As much squeeze as is needed: joints that would push at their limit for as long as they hold go less far."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from allegro_twin.control.controllers import Gains
from allegro_twin.errors import ConfigError
from allegro_twin.grasping.plan.as_scenario import rounded
from allegro_twin.grasping.trial import Trial
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.sim.drivetrain.transmission import Lengths
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector

SHARE = 0.9
"""Of its torque limit that a joint holds with: what is left is for motion and for what the hand is not told."""


def check_loop(spec: HandSpec) -> None:
    """Raises ConfigError for a hand that closes its own loop where nobody says how stiff that is: no squeeze could be
    reckoned with."""
    if "torque" not in spec.commands and spec.actuation.stiffness is None:
        raise ConfigError(f"{spec.name}: its card says no `stiffness` of what is driven; `hand new` writes it")


def resting(trial: Trial, data: Any) -> Mapping[str, float]:
    """Positions of what is driven by name, rad: what a batch of trials measures for `eased`."""
    spec, lengths = trial.backend.spec, Lengths(trial.backend.spec, trial.backend.model)
    at = lengths.position(data.qpos) if lengths.sums else lengths.look(trial.backend.model, data)[0]
    return dict(zip(spec.joints, at.tolist(), strict=True))


def eased(grasp: Grasp, rest: Vector, gains: Gains, spec: HandSpec, share: float = SHARE) -> Grasp:
    """The grasp with its squeeze no further from where its joints come to `rest` (n,), rad, than what `share` of their
    torque limits makes: kp |squeeze - rest| ≤ share · limit."""
    reach = share * spec.actuation.torque_limit / gains.kp
    return replace(grasp, squeeze=rounded(np.clip(grasp.squeeze, rest - reach, rest + reach), spec))
