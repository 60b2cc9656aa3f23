"""From the controller block of a config to a controller."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from allegro_twin.config import (
    GravitySettings,
    PerJoint,
    PolicySettings,
    PositionSettings,
    RunConfig,
    TorqueSettings,
)
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import find
from allegro_twin.loop import Controller
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector, frozen

if TYPE_CHECKING:
    from allegro_twin.control.controllers import Gains, Gravity
    from allegro_twin.control.trajectory import Reference
    from allegro_twin.evaluate.trial import Trial


def make_controller(config: RunConfig, spec: HandSpec, trial: Trial | None) -> tuple[Controller[Any], float | None]:
    """The controller, and how long its motion takes where that is known. Raises ConfigError."""
    from allegro_twin.control.controllers import PD, PID, GravityCompensation, Torque

    match config.controller:
        case TorqueSettings(torque=torque):
            return Torque(spec.vector(torque, "controller.torque")), None
        case GravitySettings(gravity=vector):
            return GravityCompensation(_gravity(spec, vector)), None
        case PolicySettings() as settings:
            return _deciding(settings, config, spec, trial)
        case PositionSettings() as settings:
            from allegro_twin.library.gains import load_gains

            gains = load_gains(settings.gains, spec)
            if trial is not None and settings.posture is None and trial.grasp.grip is not None:
                return _gripping(settings, spec, trial, gains), None
            reference, seconds = _reference(settings, spec, None if trial is None else trial.reference)
            gravity = _gravity(spec, settings.gravity) if settings.compensate else None
            if settings.kind == "pd":
                return PD(reference, gains, gravity), seconds
            return PID(reference, gains, spec.actuation.torque_limit, gravity), seconds


def posture_of(value: str | PerJoint, spec: HandSpec) -> Vector:
    """A posture by name or by value, (n,), rad. Raises ConfigError."""
    from allegro_twin.library.named import load_posture

    return load_posture(value, spec) if isinstance(value, str) else spec.posture(value)


def _deciding(
    settings: PolicySettings, config: RunConfig, spec: HandSpec, trial: Trial | None
) -> tuple[Controller[Any], float | None]:
    """A policy, and how long its script takes."""
    from allegro_twin.policy.controller import PolicyController
    from allegro_twin.policy.loading import load_policy

    path = find(settings.file, "policy", "conf/policies", ".onnx")
    loaded = load_policy(path)
    interface = loaded.card.interface(spec)
    if abs(interface.period - config.period) > 1e-9:
        raise ConfigError(f"{path} decides for a period of {interface.period} s; the config says {config.period} s")
    if trial is not None and interface.scripts is not None:
        raise ConfigError(
            f"{path} closes a grasp on its own timeline, not on a scenario's: run it without a scenario, or see what "
            "it is worth with `allegro-twin evaluate`"
        )
    goal = None
    if settings.goal is not None:
        goal = frozen(interface.fingertips(posture_of(settings.goal, spec)))
    elif interface.n_goal:
        raise ConfigError(f"{path} reaches goals: name a posture with `goal` or --goal")
    script = 0 if settings.grasp is None else loaded.card.script(settings.grasp)
    seconds = None if interface.scripts is None else interface.scripts.periods * interface.period
    return PolicyController(loaded.policy, interface, goal, script), seconds


def _gripping(settings: PositionSettings, spec: HandSpec, trial: Trial, gains: Gains) -> Controller[Any]:
    """The controller of a grasp that controls force; it always carries the hand's weight."""
    from allegro_twin.grasping import Timed, performer
    from allegro_twin.kinematics.model import HandModel

    model = HandModel(spec)
    timed = Timed(trial.reference, trial.begin_of("close"), trial.begin_of("squeeze"))
    return performer(trial.grasp, timed, spec, gains, _gravity(spec, settings.gravity), model)


def _reference(settings: PositionSettings, spec: HandSpec, grasp: Reference | None) -> tuple[Reference, float | None]:
    from allegro_twin.control.trajectory import Moves, Waypoint

    if settings.posture is None and grasp is not None:
        return grasp, None
    posture = posture_of("home" if settings.posture is None else settings.posture, spec)
    slowest = float((spec.upper - spec.lower).max()) / settings.speed * 2.0
    return Moves([Waypoint(posture, speed=settings.speed, profile=settings.profile)]), slowest + 1.0


def _gravity(spec: HandSpec, vector: tuple[float, float, float] | None) -> Gravity:
    from allegro_twin.control.controllers import Gravity
    from allegro_twin.kinematics.model import HandModel

    return Gravity(HandModel(spec).gravity_torque, None if vector is None else frozen(vector))
