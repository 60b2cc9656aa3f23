"""The rig of a run: the guarded hand of a config, its controller, and the simulation behind it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np

from allegro_twin.app.config import RunConfig
from allegro_twin.app.controllers import make_controller, with_speed_check
from allegro_twin.app.simulated import episode_of, simulated, trial_of
from allegro_twin.backend import HandBackend, limp_of
from allegro_twin.cell.arm.limits import arm_limits as arm_limits
from allegro_twin.controller import Controller
from allegro_twin.device import Device, device_of, innermost
from allegro_twin.files.schema import Settings
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.limits import check_period, hand_limits
from allegro_twin.hands.settings import LimitSettings
from allegro_twin.loop import resume
from allegro_twin.plugins import BACKENDS, BackendContext, PluginBackend, unwrapped
from allegro_twin.safety import Guard, Limits, check_speed
from allegro_twin.sim.settings import SceneSettings, SimSettings
from allegro_twin.spec import HandSpec
from allegro_twin.spec.arm import ArmSpec
from allegro_twin.types import HandState, Vector, frozen

if TYPE_CHECKING:
    from allegro_twin.grasping.trial import Trial
    from allegro_twin.learning.environments.episode import EpisodeBackend
    from allegro_twin.learning.mpc.controller import MpcController
    from allegro_twin.sim.engine.backend import SimBackend


T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """The parts of a run, ready for `run(rig.backend, rig.controller)`."""

    spec: HandSpec
    backend: HandBackend
    """Behind its guard."""
    controller: Controller[Any]
    seconds: float | None
    """When the run is over, s; None: when the backend ends."""
    trial: Trial | None = None
    """The scenario, where its scene is simulated in this program."""
    sim: SimBackend | None = None
    """The simulation of a simulated or virtual hand: for pictures, and for pushes."""
    episode: EpisodeBackend | None = None
    """The episode of an environment, where a simulated or virtual hand is in one."""

    @property
    def device(self) -> Device:
        """What the backend behind the guard tells besides the contract."""
        return device_of(self.backend)

    @property
    def live(self) -> bool:
        """Whether the hand's time passes by itself."""
        return self.device.live

    def check_speed(self, peak: Vector, what: str) -> None:
        """Raises ConfigError for a motion in which joints reach speeds, (n,), rad/s, at which the guard would stop the
        hand; `what` it is stands in the message."""
        if isinstance(self.backend, Guard):
            check_speed(peak, self.backend.limits, self.spec, what, "limits.velocity")

    @property
    def planner(self) -> MpcController | None:
        """The controller that plans while the hand moves, which is closed with the run; None for others."""
        from allegro_twin.learning.mpc.controller import MpcController

        controller = unwrapped(self.controller)
        return controller if isinstance(controller, MpcController) else None

    def with_controller(self, config: RunConfig) -> Rig:
        """A rig of the same simulated hand, scene and guard under another config's controller. Raises ConfigError."""
        made = make_controller(config, self.spec, self.trial, pose_of(self.episode)).controller
        return replace(self, controller=with_speed_check(made, self.check_speed))

    @property
    def driver(self) -> HandBackend:
        """The backend behind the guard."""
        found: HandBackend = innermost(self.backend)
        return found


Physics: TypeAlias = "Callable[[HandSpec, float], tuple[HandBackend, Trial | None]]"
"""Factory of a simulated hand, from its spec as the host knows it and the period, s: a backend, and the trial that it
is at."""
STAY = 0.5
"""s that a hand in another program is driven after its scenario: on a busy computer its time may lag behind ours."""


def limp_while(rig: Rig, state: HandState, plan: Callable[[Vector], T]) -> tuple[HandState, T]:
    """What somebody plans from where the joints of a hand are that has been reset, (n,), rad. One whose time passes by
    itself is limp meanwhile; where it has moved by then, it is planned again. Returns its newest state and the plan.
    Raises what the planning and the hand do."""
    if not rig.live:
        return state, plan(state.position)
    from allegro_twin.control.controllers import ConstantCommand
    from allegro_twin.sim.contact.collision_free_paths import SHIFTED

    limp = ConstantCommand(limp_of(rig.spec))
    with ThreadPoolExecutor(1) as pool:
        start, planned = state.position, pool.submit(plan, state.position)
        for sample in resume(rig.backend, limp, state):
            state = sample.state
            if not planned.done():
                continue
            if planned.exception() is not None or np.abs(state.position - start).max() <= SHIFTED:
                break
            start, planned = state.position, pool.submit(plan, state.position)
    return state, planned.result()


def make_backend(config: RunConfig) -> HandBackend:
    """The hand that the config describes, behind its guard. Raises HandError."""
    return assemble(config).backend


@dataclass(slots=True)
class SimulatedScene:
    """The simulation of a virtual hand in this program, and the trial that it is at."""

    sim: SimBackend | None = None
    trial: Trial | None = None
    episode: EpisodeBackend | None = None


def spec_of(config: RunConfig) -> HandSpec:
    """The hand that a config describes; on CAN its version decides how much torque its driver lets through. Raises
    ConfigError."""
    hand = config.hand
    return load_spec(hand.model, hand.side, hand.serial, getattr(config.backend, "version", None))


def open_backend(config: RunConfig, scene: SimulatedScene | None = None) -> HandBackend:
    """The hand that the config describes, without a guard. Raises HandError."""
    found: HandBackend = BACKENDS.kind(config.backend.kind).open(
        config.backend, context_of(config, scene or SimulatedScene())
    )
    return found


def context_of(config: RunConfig, scene: SimulatedScene, physics: Physics | None = None) -> BackendContext:
    """The context in which a config's backend is opened; `scene` is filled in when physics are made for it."""

    def check(spec: HandSpec) -> None:
        check_period(config.period, spec, config.controller.kind)

    def simulate(settings: Settings | None, spec: HandSpec, step: float) -> HandBackend:
        if physics is not None:
            other, scene.trial = physics(spec, step)
            return other
        if config.task.episode is not None:
            scene.episode = episode_of(config.task.episode, spec, step, config.task.posture)
            return scene.episode
        wanted = SceneSettings(kind="sim") if settings is None else settings
        assert isinstance(wanted, SimSettings)
        scene.sim, scene.trial = simulated(wanted, config.task, spec, step)
        return scene.sim

    return BackendContext(config.hand, config.period, check, simulate)


def assemble(config: RunConfig, physics: Physics | None = None) -> Rig:
    """The hand, its controller and the scenario of a config. `physics`: what stands behind a virtual hand in place of
    our simulation. Raises ConfigError, LinkError or RecordingError."""
    kind, scene = BACKENDS.kind(config.backend.kind), SimulatedScene()
    context, name = context_of(config, scene, physics), config.backend.kind
    own = name in BACKENDS.builtin
    backend = kind.open(config.backend, context) if own else PluginBackend.open(kind, config.backend, context, name)
    with ExitStack() as opened:
        opened.callback(backend.close)
        spec = backend.spec
        if not kind.replays:
            check_period(config.period, spec, config.controller.kind)
        trial = scene.trial or trial_of(config.task, spec, config.period)
        controller, seconds = make_controller(
            config, spec, trial, pose_of(scene.episode), live=not (kind.replays or scene.sim or scene.episode),
            replayed=kind.replays,
        )  # fmt: skip
        if kind.replays:
            rig = Rig(spec, backend, controller, config.seconds)
        else:
            if trial is not None:
                seconds = trial.seconds + (STAY if scene.trial is None else 0.0)
            seconds, guard = config.seconds or seconds, guarded(config, spec, backend)
            rig = Rig(spec, guard, controller, seconds, scene.trial, scene.sim, scene.episode)
            rig = replace(rig, controller=with_speed_check(controller, rig.check_speed))
        opened.pop_all()
    return rig


def pose_of(episode: EpisodeBackend | None) -> Callable[[], Vector] | None:
    """How the true pose of an episode's object is told, (7,); None without an object."""
    if episode is None or (object_body := episode.engine.task.object_body) is None:
        return None
    return lambda: frozen(object_body.pose[0])


def guarded(config: RunConfig, spec: HandSpec, backend: HandBackend) -> Guard:
    """A backend behind the config's limits, and for a hand whose fingers could hook into each other behind a look at
    where they would go. Raises ConfigError."""
    limits = limits_of(config.limits, spec)
    if not spec.apart:
        return Guard(backend, limits)
    from allegro_twin.sim.contact.interlock import Interlock

    return Guard(backend, limits, Interlock(spec))


def limits_of(settings: LimitSettings, spec: HandSpec) -> Limits:
    """What a config lets through, of a hand or of an arm. Raises ConfigError."""
    limits = hand_limits(settings, spec)
    if not isinstance(spec, ArmSpec):
        return limits
    return replace(arm_limits(spec, settings.margin, limits.velocity), torque=limits.torque)
