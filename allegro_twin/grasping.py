"""From a grasp in the library to the controller that performs it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from allegro_twin.control.controllers import PD, Gains, Gravity
from allegro_twin.control.force_grasp import CentroidGrasp, EnvelopGrasp
from allegro_twin.control.trajectory import Moves
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.model import HandModel
from allegro_twin.library.grasps import Grasp
from allegro_twin.library.grip import CentroidGrip, EnvelopGrip
from allegro_twin.loop import Controller
from allegro_twin.spec import HandSpec


@dataclass(frozen=True, slots=True, eq=False)
class Timed:
    """The motion of a grasp on the controller's clock."""

    moves: Moves
    """Through pre-shape, close and squeeze."""
    close_at: float
    """When the fingers begin to close, s."""
    squeeze_at: float
    """When they squeeze, s."""


def performer(
    grasp: Grasp,
    timed: Timed,
    spec: HandSpec,
    gains: Gains,
    gravity: Gravity,
    model: HandModel,
    *,
    force: float | None = None,
) -> Controller[Any]:
    """The controller of a grasp. `force`: on the thumb of a centroid grasp, N, or the scale of an envelop grasp, in
    place of what is stored. Raises ConfigError for a force that is not positive, or that a position grasp cannot set.
    """
    if force is not None and not force > 0.0:
        raise ConfigError(f"grasp {grasp.name}: force must be positive, not {force}")
    reach = PD(timed.moves, gains, gravity)
    match grasp.grip:
        case CentroidGrip() as grip:
            return _centroid(grip, reach, timed, spec, gravity, model, force)
        case EnvelopGrip() as grip:
            return _envelop(grip, reach, timed, spec, gravity, force)
    if force is not None:
        raise ConfigError(f"grasp {grasp.name} controls position and takes no force; a centroid grasp does")
    return reach


def _centroid(
    grip: CentroidGrip,
    reach: PD,
    timed: Timed,
    spec: HandSpec,
    gravity: Gravity,
    model: HandModel,
    force: float | None,
) -> CentroidGrasp:
    fingers = grip.fingers
    return CentroidGrasp(
        reach,
        timed.close_at,
        timed.squeeze_at,
        lambda position: model.fingertip_jacobians(position, fingers),
        np.array([spec.finger(name).joints for name in fingers]),
        gravity,
        grip.closing * spec.actuation.torque_limit,
        np.maximum(spec.actuation.frictionloss, 1e-6),
        grip.force if force is None else force,
        spread=grip.spread,
        stiffness=grip.stiffness,
    )


def _envelop(
    grip: EnvelopGrip, reach: PD, timed: Timed, spec: HandSpec, gravity: Gravity, force: float | None
) -> EnvelopGrasp:
    torque = np.zeros(spec.n_actuators)
    for name, values in grip.torque.items():
        torque[list(spec.finger(name).joints)] = values
    scale = grip.scale if force is None else force
    return EnvelopGrasp(
        reach,
        timed.close_at,
        timed.squeeze_at,
        gravity,
        np.array([spec.finger(name).joints for name in grip.torque]),
        torque,
        scale=scale,
        closing_scale=grip.closing,
        stiffness=grip.stiffness,
    )
