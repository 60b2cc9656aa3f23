"""Grasp controllers: a grasp of the library as the controller that performs it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from allegro_twin.control.controllers import PD, Gains, GravityFeedforward
from allegro_twin.control.force_grasp import CentroidGrasp, EnvelopGrasp, LatchGrasp, LatchParameters
from allegro_twin.control.trajectory import Moves
from allegro_twin.controller import Controller
from allegro_twin.errors import ConfigError
from allegro_twin.hands.library.entries import CentroidGrip, EnvelopGrip, LatchGrip
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.kinematics.hand import HandKinematics
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector


class ContactSource(Protocol):
    """Source of contacts: a mirror."""

    @property
    def contacts(self) -> tuple[str, ...]:
        """The names of the fingers that something touches now."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class TimedGrasp:
    """The motion of a grasp on the controller's clock."""

    moves: Moves
    """Through pre-shape, close and squeeze."""
    close_at: float
    """When the fingers begin to close, s."""
    squeeze_at: float
    """When they squeeze, s."""


def make_grasp_controller(
    grasp: Grasp,
    timed: TimedGrasp,
    spec: HandSpec,
    gains: Gains,
    gravity: GravityFeedforward,
    model: HandKinematics,
    *,
    force: float | None = None,
    touched: ContactSource | None = None,
) -> Controller[Any]:
    """The controller of a grasp. `force`: on the thumb of a centroid grasp, N, or the scale of an envelop grasp, in
    place of what is stored; `touched`: whom a centroid grasp asks, instead of torque and stillness, which of its
    fingers have met the object. Raises ConfigError for a force that is not positive, that the motors do not have, or
    that a position grasp cannot set, and for a grasp that asks nobody.
    """
    if touched is not None and not isinstance(grasp.grip, CentroidGrip):
        raise ConfigError(f"grasp {grasp.name} asks nobody what its fingers touch; a centroid grasp does")
    if force is not None and not force > 0.0:
        raise ConfigError(f"grasp {grasp.name}: force must be positive, not {force}")
    if (
        force is not None
        and isinstance(grasp.grip, CentroidGrip | EnvelopGrip)
        and force > (most := max_grasp_force(grasp, spec, model))
    ):
        unit = " N" if isinstance(grasp.grip, CentroidGrip) else " times its torques"
        raise ConfigError(f"grasp {grasp.name}: force is at most {most:.1f}{unit}, what the motors have; not {force:g}")
    reach = PD(timed.moves, gains, gravity)
    match grasp.grip:
        case CentroidGrip() as grip:
            asked = None if touched is None else _asking(touched, grip.fingers)
            return _centroid(grip, reach, timed, spec, gravity, model, force, asked)
        case EnvelopGrip() as grip:
            return _envelop(grip, reach, timed, spec, gravity, force)
    if force is not None:
        raise ConfigError(f"grasp {grasp.name} controls position and takes no force; a centroid grasp does")
    if isinstance(grasp.grip, LatchGrip):
        return _latching(grasp, grasp.grip, timed, spec, gains, gravity)
    return reach


def max_grasp_force(grasp: Grasp, spec: HandSpec, model: HandKinematics) -> float:
    """The most that the motors can give of a grasp's force: on the thumb, toward the other fingertips, in that posture
    of the grasp in which it is largest, N; or the scale at which the last joint of an envelop grasp is at its limit."""
    limit = spec.actuation.torque_limit
    if isinstance(grasp.grip, EnvelopGrip):
        torque = _wrapping(grasp.grip, spec)
        return float((limit[torque != 0.0] / np.abs(torque[torque != 0.0])).max())
    assert isinstance(grasp.grip, CentroidGrip)
    fingers, found = grasp.grip.fingers, []
    for posture in (grasp.preshape, grasp.close, grasp.squeeze):
        tips, jacobians = model.fingertip_jacobians(posture, fingers)
        way = tips[:-1].mean(axis=0) - tips[-1]
        torque = np.abs(jacobians[-1].T @ way) / np.linalg.norm(way)
        found.append(float((limit[torque > 1e-9] / torque[torque > 1e-9]).min()))
    return max(found)


def _wrapping(grip: EnvelopGrip, spec: HandSpec) -> Vector:
    """The closing torques of an envelop grasp, (n,), N·m."""
    torque = np.zeros(spec.n_actuators)
    for name, values in grip.torque.items():
        torque[list(spec.finger(name).joints)] = values
    return torque


def _centroid(
    grip: CentroidGrip,
    reach: PD,
    timed: TimedGrasp,
    spec: HandSpec,
    gravity: GravityFeedforward,
    model: HandKinematics,
    force: float | None,
    felt: Callable[[], NDArray[np.bool_]] | None,
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
        contacts=felt,
    )


def _asking(touched: ContactSource, fingers: tuple[str, ...]) -> Callable[[], NDArray[np.bool_]]:
    def felt() -> NDArray[np.bool_]:
        now = touched.contacts
        return np.array([name in now for name in fingers])

    return felt


def _envelop(
    grip: EnvelopGrip, reach: PD, timed: TimedGrasp, spec: HandSpec, gravity: GravityFeedforward, force: float | None
) -> EnvelopGrasp:
    scale = grip.scale if force is None else force
    return EnvelopGrasp(
        reach,
        timed.close_at,
        timed.squeeze_at,
        gravity,
        np.array([spec.finger(name).joints for name in grip.torque]),
        _wrapping(grip, spec),
        scale=scale,
        closing_scale=grip.closing,
        stiffness=grip.stiffness,
    )


FREE, RAMP = 0.01, 0.25
"""rad: a joint that closes by less does not go on beyond; and s, from latching to the whole squeeze."""


def _latching(
    grasp: Grasp, grip: LatchGrip, timed: TimedGrasp, spec: HandSpec, gains: Gains, gravity: GravityFeedforward
) -> LatchGrasp:
    ones, motors = np.ones(spec.n_joints), spec.actuation
    travel = grasp.close - grasp.preshape
    beyond = np.clip(grasp.close + np.where(np.abs(travel) > FREE, grip.beyond * np.sign(travel), 0.0), spec.lower,
                     spec.upper) - grasp.close  # fmt: skip
    parameters = LatchParameters(
        gains.kp * ones, gains.kd * ones, timed.close_at, timed.squeeze_at, RAMP,
        grip.closing * motors.torque_limit + motors.frictionloss, motors.damping * ones, beyond,
        grasp.squeeze - grasp.close,
    )  # fmt: skip
    return LatchGrasp(timed.moves, parameters, gravity)
