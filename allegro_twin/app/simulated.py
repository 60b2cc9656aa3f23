"""Simulated hands: alone, or at a scenario."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from allegro_twin.app.config import RunConfig
from allegro_twin.app.references import posture_of
from allegro_twin.backend import HandBackend
from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import PerJoint, parse_settings
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.settings import EpisodeSettings, HandSettings, TaskSettings
from allegro_twin.plugins import BackendContext, BackendKind
from allegro_twin.sim.settings import SimSettings
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector, frozen

if TYPE_CHECKING:
    from allegro_twin.grasping.trial import Trial
    from allegro_twin.learning.environments.episode import EpisodeBackend
    from allegro_twin.learning.environments.settings import EnvSettings
    from allegro_twin.sim.engine.backend import SimBackend


class Simulated(NamedTuple):
    """A simulated hand, and the scenario that it is at, if any."""

    backend: SimBackend
    trial: Trial | None


def simulated(settings: SimSettings, task: TaskSettings, spec: HandSpec, period: float) -> Simulated:
    """The hand in MuJoCo that a config describes, in the scene of its task. Raises ConfigError."""
    start = None if settings.start is None else posture_of(settings.start, spec)
    trial = trial_of(task, spec, period, start)
    return Simulated(_alone(settings, spec, period, start), None) if trial is None else Simulated(trial.backend, trial)


def episode_environment(episode: EpisodeSettings, spec: HandSpec, period: float) -> EnvSettings:
    """The environment of a config's episode, with its hand. Raises ConfigError."""
    from allegro_twin.learning.environments.settings import EnvSettings

    own = {"hand": spec.model_reference, "side": spec.side, "period": period}
    for name in own.keys() & episode.environment.keys():
        block = "period" if name == "period" else f"hand.{'model' if name == 'hand' else name}"
        raise ConfigError(f"task.episode.environment.{name} is the config's {block}: leave it out")
    if episode.environment.get("device", "cpu") != "cpu":
        raise ConfigError("task.episode.environment.device: a hand is driven on cpu: leave it out")
    return parse_settings(EnvSettings, episode.environment | own, "task.episode.environment")


def episode_of(
    episode: EpisodeSettings, spec: HandSpec, period: float, posture: str | PerJoint | None = None
) -> EpisodeBackend:
    """A hand in the scene of a config's episode, its object included. `posture`: the task's, whose fingertips are the
    goal of an episode that has such goals. Raises ConfigError."""
    from allegro_twin.learning.environments.episode import EpisodeBackend

    made = EpisodeBackend(episode.task, episode_environment(episode, spec, period), episode.seed)
    interface = made.engine.task.interface
    if posture is not None and interface.goal == "fingertips":
        made.wanted_goal = frozen(interface.fingertips(posture_of(posture, spec)))
    return made


def trial_of(task: TaskSettings, spec: HandSpec, period: float, start: Vector | None = None) -> Trial | None:
    """The scenario of a task, if it has one: watched where its scene is simulated; elsewhere the timeline that the
    fingers follow. Raises ConfigError."""
    if task.scenario is None:
        return None
    from allegro_twin.grasping.trial import make_trial

    return make_trial(task.scenario, spec, period, start, grasp=task.grasp, object_name=task.object)


def scenario_config(
    scenario: Path | str, side: str | None = None, grasp: str | None = None, object_name: str | None = None
) -> RunConfig:
    """The config that runs a scenario as it is, or with another grasp or object: simulated, under PD or the firmware's
    own loop, with the nominal hand, in the period and with the gains that its protocol asks for."""
    from allegro_twin.grasping.scenario import load_scenario, scenario_protocol

    settings, path = load_scenario(scenario)
    rules = scenario_protocol(settings, path)
    hand = HandSettings.model_validate({"model": settings.hand, "side": side or settings.side})
    return RunConfig.model_validate(
        {
            "hand": hand.model_dump(),
            "backend": {"kind": "sim"},
            "task": {"scenario": str(path), "grasp": grasp, "object": object_name},
            "controller": following(hand, rules.gains),
        }
        | ({} if rules.period is None else {"period": rules.period})
    )


def following(hand: HandSettings, gains: str | None = None) -> dict[str, str]:
    """The controller with which a hand performs what a task asks: PD, or its firmware's own loop."""
    if "torque" not in load_spec(hand.model, hand.side, hand.serial).commands:
        return {"kind": "position"}
    return {"kind": "pd"} if gains is None else {"kind": "pd", "gains": gains}


def _alone(settings: SimSettings, spec: HandSpec, period: float, start: Vector | None) -> SimBackend:
    from allegro_twin.kinematics.orientation import quaternion_facing
    from allegro_twin.sim.engine.backend import SimBackend
    from allegro_twin.sim.model.physics import Physics
    from allegro_twin.sim.model.scene import Stage, compile_scene

    step = getattr(settings, "timestep", None)
    spec.check_step(step or 0.0, "timestep")
    stage = Stage(
        np.zeros(3),
        quaternion_facing(settings.facing, settings.fingers),
        physics=Physics() if step is None else Physics(timestep=step),
    )
    return SimBackend(spec, compile_scene(spec, stage), period=period, posture=start)


def open_simulated(settings: SimSettings, context: BackendContext) -> HandBackend:
    """The hand in MuJoCo, in the scene of the task. Raises ConfigError."""
    spec = context.spec()
    context.check(spec)
    return context.simulate(settings, spec, context.period)


KIND = BackendKind(SimSettings, open_simulated)
