"""Controllers made from the controller block of a config."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from allegro_twin.app.config import RunConfig
from allegro_twin.app.controller_settings import (
    CartesianSettings,
    FollowSettings,
    GravitySettings,
    LimpSettings,
    PlanningSettings,
    PolicySettings,
    PositionSettings,
    TorqueSettings,
)
from allegro_twin.app.references import posture_of, wanted_of
from allegro_twin.app.simulated import episode_environment
from allegro_twin.backend import limp_of
from allegro_twin.controller import Controller
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import find_file
from allegro_twin.plugin_faults import as_plugin_fault
from allegro_twin.plugins import (
    CONTROLLERS,
    ControllerContext,
    ControllerKind,
    MadeController,
    PluginController,
    member_of,
)
from allegro_twin.spec import HandSpec
from allegro_twin.spec.arm import ArmSpec
from allegro_twin.types import HandState, Vector, frozen

if TYPE_CHECKING:
    from allegro_twin.control.controllers import Gains, GravityFeedforward
    from allegro_twin.control.motion_feedforward import MotionFeedforward
    from allegro_twin.control.trajectory import SpeedCheck
    from allegro_twin.grasping.controller import TimedGrasp
    from allegro_twin.grasping.trial import Trial
    from allegro_twin.hands.library.grasps import Grasp


_ARMS = ("impedance", "compliance", "torque", "limp")
"""Controllers of an arm, which carries its own weight."""


def make_controller(
    config: RunConfig,
    spec: HandSpec,
    trial: Trial | None,
    object_pose: Callable[[], Vector] | None = None,
    *,
    live: bool = False,
    replayed: bool = False,
) -> MadeController:
    """The controller, and how long its motion takes where that is known. `object_pose`: of a simulated hand's episode,
    (7,); `live`: whether the hand's time passes by itself; `replayed`: whether its motion is a recording's. Raises
    ConfigError."""
    settings, kind = config.controller, CONTROLLERS.kind(config.controller.kind)
    context = ControllerContext(spec, config.period, config.task, trial, object_pose, live, replayed)
    if settings.kind not in CONTROLLERS.builtin:
        return PluginController.make(kind, settings, context, settings.kind)
    check_kind(settings.kind, spec)
    made: MadeController = kind.make(settings, context)
    return made


def with_speed_check(controller: Any, check: SpeedCheck) -> Any:
    """The controller; a motion that it follows is looked at before it begins."""
    from allegro_twin.control.controllers import PD
    from allegro_twin.control.trajectory import Moves, Trajectory
    from allegro_twin.sim.contact.collision_free_paths import CollisionFreeMove

    if isinstance(controller, PluginController):  # Of another package's class nobody can make a changed copy.

        def look(theirs: Any, state: HandState) -> None:
            for each in (theirs, member_of(theirs, "reach")):
                reference = member_of(each, "reference")
                if not isinstance(reference, Moves | CollisionFreeMove):
                    continue
                kind = type(reference)
                with as_plugin_fault(kind, f"controller {controller.kind}: {kind.__qualname__}.begin", "controller"):
                    path: object = reference.begin(state.position)  # As it was planned at the start.
                if isinstance(path, Trajectory):
                    check(path.peak, "the motion")

        return controller.with_look(look)
    reach, reference = getattr(controller, "reach", None), getattr(controller, "reference", None)
    if isinstance(reach, PD):
        return replace(controller, reach=with_speed_check(reach, check))
    if isinstance(reference, Moves | CollisionFreeMove):
        return replace(controller, reference=reference.checked(check))
    return controller


def check_kind(kind: str, spec: HandSpec) -> None:
    """Raises ConfigError for a controller whose commands this hand, or arm, does not take."""
    if isinstance(spec, ArmSpec) and kind not in _ARMS:
        raise ConfigError(f"controller.kind {kind} is for hands; {spec.name} is an arm: use {', '.join(_ARMS)}")
    if not isinstance(spec, ArmSpec) and kind in ("impedance", "compliance"):
        raise ConfigError(f"controller.kind {kind} is for arms; {spec.name} is a hand: use pd, pid or position")
    if kind == "position" and "torque" in spec.commands:
        raise ConfigError(f"controller.kind position is for a hand whose firmware closes the loop; {spec.name}: use pd")
    if kind not in ("position", "limp", "policy", "mpc") and "torque" not in spec.commands:
        raise ConfigError(f"controller.kind {kind} commands torques; {spec.name} takes {', '.join(spec.commands)}: "
                          "use position or limp, or a policy")  # fmt: skip


def _limp(settings: LimpSettings, context: ControllerContext) -> MadeController:
    from allegro_twin.control.controllers import ConstantCommand

    return MadeController(ConstantCommand(limp_of(context.spec)))


def _torque(settings: TorqueSettings, context: ControllerContext) -> MadeController:
    from allegro_twin.control.controllers import ConstantTorque

    return MadeController(ConstantTorque(context.spec.vector(settings.torque, "controller.torque")))


def _gravity_compensation(settings: GravitySettings, context: ControllerContext) -> MadeController:
    from allegro_twin.control.controllers import GravityCompensation

    return MadeController(GravityCompensation(_gravity(context.spec, settings.gravity)))


def _setpoints(settings: FollowSettings, context: ControllerContext) -> MadeController:
    """Positions for the hand's own loop."""
    from allegro_twin.control.controllers import PositionControl

    spec, wanted = context.spec, wanted_of(settings, context)
    if wanted.grasp is not None and wanted.grasp.grip is not None:
        raise ConfigError(f"grasp {wanted.grasp.name} controls force by torques; {spec.name} takes none")
    effort = None if settings.effort is None else spec.vector(settings.effort, "controller.effort")
    return MadeController(PositionControl(wanted.reference, effort), wanted.seconds)


def _policy(settings: PolicySettings, context: ControllerContext) -> MadeController:
    """A policy, and how long its script takes."""
    from allegro_twin.learning.policy.controller import PolicyController
    from allegro_twin.learning.policy.loading import load_policy

    spec, trial = context.spec, context.trial
    path = find_file(settings.file, "policy", "conf/policies", ".onnx")
    loaded = load_policy(path, trust=settings.trust)
    interface = loaded.card.interface(spec)
    if abs(interface.period - context.period) > 1e-9:
        raise ConfigError(f"{path} decides for a period of {interface.period} s; the config says {context.period} s")
    if trial is not None and interface.scripts is not None:
        raise ConfigError(
            f"{path} closes a grasp on its own timeline, not on a scenario's: run it without a scenario, or see what "
            "it is worth with `allegro-twin evaluate`"
        )
    goal, task = None, context.task
    if interface.n_goal and task.posture is None:
        raise ConfigError(f"{path} reaches goals: name a posture with task.posture or --goal")
    if task.posture is not None:
        if not interface.n_goal:
            raise ConfigError(f"{path} reaches no goals: leave out task.posture")
        goal = frozen(interface.fingertips(posture_of(task.posture, spec)))
    script = 0 if task.grasp is None or trial is not None else loaded.card.script(task.grasp)
    seconds = None if interface.scripts is None else interface.scripts.periods * interface.period
    return MadeController(PolicyController(loaded.policy, interface, goal, script), seconds)


def _mpc(settings: PlanningSettings, context: ControllerContext) -> MadeController:
    """A planner for the task's episode, and how long that lasts."""
    from allegro_twin.learning.mpc.controller import MpcController
    from allegro_twin.learning.mpc.observed import ObservedEpisode, PoseTracker
    from allegro_twin.learning.mpc.settings import PoseCamera, planner_settings

    spec, episode = context.spec, context.task.episode
    assert episode is not None  # A rule of the config.
    if settings.time == "lockstep" and context.live:
        raise ConfigError("controller.time lockstep: the time of this hand passes by itself; choose time: real")
    camera = settings.camera or PoseCamera(period=context.period, window=context.period)
    poses = None if context.object_pose is None else PoseTracker(context.object_pose, camera)
    if settings.camera is not None and poses is None:
        raise ConfigError(f"controller.camera: {episode.task} has no object here to look at; leave it out")
    model = ObservedEpisode(episode.task, episode_environment(episode, spec, context.period), episode.seed, poses)
    interface = model.engine.task.interface
    if context.task.posture is not None:
        if interface.goal != "fingertips":
            raise ConfigError(f"task.posture is a goal of fingertips, and {episode.task} has none: leave it out, or "
                              "plan for Reach")  # fmt: skip
        model.goal = interface.fingertips(posture_of(context.task.posture, spec))
    real_time = settings.time == "real"
    planning = settings.planning or planner_settings(episode.task, real_time=real_time)
    place = "" if settings.planning is None else "controller.planning."
    controller = MpcController(
        episode.task, model, planning, real_time=real_time, threads=settings.threads, place=place
    )
    return MadeController(controller, model.engine.limit * interface.seconds)


def _position(settings: PositionSettings, context: ControllerContext) -> MadeController:
    """PD or PID on what the task asks for; a grasp that controls force has its own."""
    from allegro_twin.control.controllers import PD, PID
    from allegro_twin.hands.library.gains import load_gains

    spec, wanted = context.spec, wanted_of(settings, context)
    gains = load_gains(settings.gains, spec)
    gravity = _gravity(spec, settings.gravity) if settings.compensate else None
    motion = _motion(spec, context.period) if settings.inverse_dynamics else None
    if wanted.grasp is not None and wanted.grasp.grip is not None:
        return MadeController(_gripping(settings, wanted.grasp, wanted.timed(), spec, gains), wanted.seconds)
    if settings.kind == "pd":
        return MadeController(PD(wanted.reference, gains, gravity, motion), wanted.seconds)
    limit = spec.actuation.torque_limit
    return MadeController(PID(wanted.reference, gains, limit, gravity, motion), wanted.seconds)


def _motion(spec: HandSpec, period: float) -> MotionFeedforward:
    """By the hand's own file where it has one. Raises ConfigError for a hand with coupled joints."""
    from allegro_twin.control.motion_feedforward import MotionFeedforward
    from allegro_twin.kinematics.hand import hand_kinematics

    model, drive = hand_kinematics(spec), spec.drive
    if not model.direct:
        raise ConfigError(
            f"controller.inverse_dynamics is for hands whose motors each turn one joint; {spec.name} has coupled "
            "joints: leave it out"
        )
    stray = None
    if drive is not None and drive.parasitic:
        from allegro_twin.sim.drivetrain.parasitic_torque import torque

        stray = partial(torque, drive)
    lead = period / 2.0 + (0.0 if drive is None else drive.delay)
    return MotionFeedforward(model.inverse_dynamics, spec.actuation, lead, stray)


def _gripping(
    settings: PositionSettings, grasp: Grasp, timed: TimedGrasp, spec: HandSpec, gains: Gains
) -> Controller[Any]:
    """The controller of a grasp that controls force; it always carries the hand's weight."""
    from allegro_twin.grasping.controller import make_grasp_controller
    from allegro_twin.kinematics.hand import hand_kinematics

    wrong = {"kind: pid": settings.kind != "pd", "compensate: false": not settings.compensate,
             "inverse_dynamics": settings.inverse_dynamics}  # fmt: skip
    if keys := [key for key, said in wrong.items() if said]:
        raise ConfigError(
            f"grasp {grasp.name} controls force, under PD and with the hand's weight carried; leave out "
            f"{' and '.join(keys)}"
        )
    return make_grasp_controller(grasp, timed, spec, gains, _gravity(spec, settings.gravity), hand_kinematics(spec))


def _gravity(spec: HandSpec, vector: tuple[float, float, float] | None) -> GravityFeedforward:
    from allegro_twin.control.controllers import GravityFeedforward
    from allegro_twin.kinematics.hand import hand_kinematics

    return GravityFeedforward(hand_kinematics(spec).gravity_torque, None if vector is None else frozen(vector))


def _cartesian(settings: CartesianSettings, context: ControllerContext) -> MadeController:
    from allegro_twin.app.cartesian_control import leading

    return MadeController(*leading(settings, context.spec))


LIMP = ControllerKind(LimpSettings, _limp)
TORQUE = ControllerKind(TorqueSettings, _torque)
GRAVITY = ControllerKind(GravitySettings, _gravity_compensation)
POSITION = ControllerKind(PositionSettings, _position)
SETPOINTS = ControllerKind(FollowSettings, _setpoints)
MPC = ControllerKind(PlanningSettings, _mpc)
POLICY = ControllerKind(PolicySettings, _policy)
CARTESIAN = ControllerKind(CartesianSettings, _cartesian)
