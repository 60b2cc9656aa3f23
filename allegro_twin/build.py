"""The one place that joins the parts: from a config to a guarded hand, its controller, and what surrounds them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from allegro_twin.backend import HandBackend
from allegro_twin.config import (
    GravitySettings,
    PerJoint,
    PositionSettings,
    ReplaySettings,
    RunConfig,
    SimSettings,
    TorqueSettings,
)
from allegro_twin.description.hands import load_spec
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import find
from allegro_twin.loop import Controller
from allegro_twin.safety import Guard, Limits
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector, frozen

if TYPE_CHECKING:
    from allegro_twin.control.controllers import Gains, Gravity
    from allegro_twin.control.trajectory import Reference
    from allegro_twin.evaluate.trial import Trial
    from allegro_twin.sim.backend import SimBackend


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Everything a run needs, ready for `run(rig.backend, rig.controller)`."""

    spec: HandSpec
    backend: HandBackend
    """Behind its guard."""
    controller: Controller[Any]
    seconds: float | None
    """When it is over; None: when the backend ends."""
    trial: Trial | None = None
    """The scenario, where there is one."""
    sim: SimBackend | None = None
    """The simulation behind the guard, where there is one: for pictures."""


def make_backend(config: RunConfig) -> HandBackend:
    """The hand that the config describes, behind its guard. Raises HandError."""
    return assemble(config).backend


def assemble(config: RunConfig) -> Rig:
    """The hand, its controller and the scenario. Raises ConfigError, LinkError or RecordingError."""
    match config.backend:
        case SimSettings() as settings:
            return _simulated(config, settings)
        case ReplaySettings() as settings:
            return _replayed(config, settings)


def _simulated(config: RunConfig, settings: SimSettings) -> Rig:
    spec = load_spec(config.hand.model, config.hand.side, config.hand.serial)
    start = None if settings.posture is None else _posture(settings.posture, spec)
    if settings.scenario is None:
        backend, seconds = _alone(config, settings, spec, start), config.seconds
        controller, motion = _controller(config, spec, None)
        return Rig(spec, _guarded(config, spec, backend), controller, seconds or motion, sim=backend)
    trial = make_trial(settings.scenario, spec, config.period, start, grasp=settings.grasp, thing=settings.thing)
    controller, _ = _controller(config, spec, trial)
    guarded = _guarded(config, spec, trial.backend)
    return Rig(spec, guarded, controller, config.seconds or trial.seconds, trial, trial.backend)


def make_trial(
    scenario: str,
    spec: HandSpec,
    period: float = 0.003,
    start: Vector | None = None,
    *,
    grasp: str | None = None,
    thing: str | None = None,
) -> Trial:
    """A scenario by name or path, ready to run with this hand; with another grasp, or another object of the catalogue
    in place of its first, if they are named. Raises ConfigError."""
    from allegro_twin.evaluate.scenario import ObjectSettings, load_scenario
    from allegro_twin.evaluate.trial import Trial
    from allegro_twin.library.named import load_grasp

    settings, path = load_scenario(scenario)
    if thing is not None:
        others = settings.objects[1:]
        settings = settings.model_copy(update={"objects": (ObjectSettings(name=thing), *others)})
    chosen = load_grasp(grasp or settings.grasp, spec)
    return Trial(settings, spec, chosen, folder=path.parent, period=period, start=start)


def _alone(config: RunConfig, settings: SimSettings, spec: HandSpec, start: Vector | None) -> SimBackend:
    from allegro_twin.sim.backend import SimBackend
    from allegro_twin.sim.pose import orientation
    from allegro_twin.sim.scene import Stage, compile_scene

    stage = Stage(np.zeros(3), orientation(settings.facing, settings.fingers))
    return SimBackend(spec, compile_scene(spec, stage), period=config.period, posture=start)


def _replayed(config: RunConfig, settings: ReplaySettings) -> Rig:
    from allegro_twin.replay.backend import ReplayBackend
    from allegro_twin.replay.recording import load

    path = find(settings.file, "recording", "out", ".arrow")
    recording = load(path, partial=settings.partial)
    backend = ReplayBackend(recording)
    if backend.spec.side != config.hand.side or backend.spec.model != config.hand.model:
        wanted = f"{config.hand.model}_{config.hand.side}"
        raise ConfigError(f"{path} is of the hand {backend.spec.name}; the config says {wanted}: change `hand`")
    if abs(backend.period - config.period) > 1e-9:
        raise ConfigError(f"{path} has a period of {backend.period} s; the config says {config.period} s")
    controller, _ = _controller(config, backend.spec, None)
    # A recording is not limited: what happened, happened.
    return Rig(backend.spec, backend, controller, config.seconds)


def _controller(config: RunConfig, spec: HandSpec, trial: Trial | None) -> tuple[Controller[Any], float | None]:
    """The controller, and how long its motion takes where that is known."""
    from allegro_twin.control.controllers import PD, PID, GravityCompensation, Torque

    match config.controller:
        case TorqueSettings(torque=torque):
            return Torque(spec.vector(torque, "controller.torque")), None
        case GravitySettings(gravity=vector):
            return GravityCompensation(_gravity(spec, vector)), None
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
    posture = _posture("home" if settings.posture is None else settings.posture, spec)
    slowest = float((spec.upper - spec.lower).max()) / settings.speed * 2.0
    return Moves([Waypoint(posture, speed=settings.speed, profile=settings.profile)]), slowest + 1.0


def _posture(value: str | PerJoint, spec: HandSpec) -> Vector:
    from allegro_twin.library.named import load_posture

    return load_posture(value, spec) if isinstance(value, str) else spec.posture(value)


def _gravity(spec: HandSpec, vector: tuple[float, float, float] | None) -> Gravity:
    from allegro_twin.control.controllers import Gravity
    from allegro_twin.kinematics.model import HandModel

    return Gravity(HandModel(spec).gravity_torque, None if vector is None else frozen(vector))


def _guarded(config: RunConfig, spec: HandSpec, backend: HandBackend) -> Guard:
    settings = config.limits
    torque = spec.actuation.torque_limit
    if settings.torque is not None:
        torque = np.minimum(torque, spec.vector(settings.torque, "limits.torque"))
    velocity = spec.vector(settings.velocity, "limits.velocity")
    for name, values in (("torque", torque), ("velocity", velocity)):
        if not (values > 0).all():
            raise ConfigError(f"limits.{name} must be positive; it is {values.min()}")
    if settings.margin * 2 >= float((spec.upper - spec.lower).min()):
        raise ConfigError(f"limits.margin {settings.margin} rad leaves some joint no range")
    lower, upper = spec.lower + settings.margin, spec.upper - settings.margin
    return Guard(backend, Limits(frozen(torque), velocity, frozen(lower), frozen(upper)))


def scenario_config(
    scenario: Path | str, side: str | None = None, grasp: str | None = None, thing: str | None = None
) -> RunConfig:
    """The config that runs a scenario as it is, or with another grasp or object: simulated, under PD, with the nominal
    hand."""
    from allegro_twin.evaluate.scenario import load_scenario

    settings, path = load_scenario(scenario)
    return RunConfig.model_validate(
        {
            "hand": {"side": side or settings.side},
            "backend": {"kind": "sim", "scenario": str(path), "grasp": grasp, "thing": thing},
            "controller": {"kind": "pd"},
        }
    )
