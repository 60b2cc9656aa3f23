"""One hand's scenes: for every object a model that is compiled once, and changed a little for each trial."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from allegro_twin.control import GravityFeedforward
from allegro_twin.grasping import (
    Perturbation,
    Phase,
    PhysicsSettings,
    Scenario,
    TrialProtocol,
    load_scenario,
    make_stage,
)
from allegro_twin.hands import Grasp, LimitSettings, hand_limits, load_gains, load_grasp, load_spec
from allegro_twin.kinematics import hand_kinematics
from allegro_twin.sim.model import (
    Stage,
    WristSegment,
    WristServo,
    compile_scene,
    set_wrist_servo,
    wrist_load,
    wrist_set_points,
)
from allegro_twin.types import Array
from studies.preemption.draws import Case
from studies.preemption.protocol import Control, Policy, SpringArm, SpringStudy

if TYPE_CHECKING:
    import mujoco


class Job(NamedTuple):
    """One trial that is asked for."""

    policy: Policy
    case: Case
    control: Control | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """One trial, ready to be simulated."""

    job: Job
    model: mujoco.MjModel
    grasp: Grasp
    thing: Array
    """Where the object is at the beginning: position and quaternion, (7,), m, world."""
    width: float
    """Of the object, where it is narrowest, m."""
    goal: Array
    """Where the palm grasps, (3,), m, world."""
    drive: Array
    """The arm's set-points from the retreat to the end, without what it waits, (steps, 6)."""
    weight: float
    """What the hand weighs, N."""


class Bench:
    """Makes trials of one hand. Raises ConfigError for a hand, or an object, that has no scenario."""

    def __init__(self, study: SpringStudy, hand: str) -> None:
        self.study, self.hand = study, hand
        self.spec = load_spec(hand)
        self.limits = hand_limits(LimitSettings(), self.spec)
        self.gains = load_gains("default", self.spec)
        self.gravity = GravityFeedforward(hand_kinematics(self.spec).gravity_torque)
        self._made: dict[tuple[object, ...], tuple[mujoco.MjModel, Stage, Scenario, Grasp]] = {}

    def setup(self, job: Job) -> Setup:
        """Everything that one trial needs."""
        physics = self._physics(job.control)
        base, scene, scenario, grasp = self._base(job.case.object, physics)
        model = copy.copy(base)
        model.geom_friction[:, 0] = job.case.friction
        if job.control is not None and job.control.frozen:
            grasp = replace(grasp, close=grasp.preshape, squeeze=grasp.preshape)
        placed = Perturbation(job.case.x, job.case.y, job.case.yaw).on(scene).objects[0]
        goal = scene.position - np.array(scenario.wrist.retreat)
        down = -physics.physics().gravity[2]
        load = wrist_load(model)
        return Setup(
            job, model, grasp, np.array([*placed.position, *placed.quaternion]),
            2.0 * float(placed.grasp_object.half_extents().min()), goal,
            self._drive(job.case.approach, goal - scene.position, base.opt.timestep, load, down), load * down,
        )  # fmt: skip

    def _drive(self, seconds: float, way: Array, timestep: float, load: float, gravity: float) -> Array:
        """Approach, lift, hold and shake without a stop between them, (steps, 6)."""
        motion, still = self.study.motion, np.zeros(6)
        shake = np.array([*[motion.shake.acceleration] * 3, 0.0, 0.0, 0.0])
        segments = [
            WristSegment(seconds, np.array([*way, 0.0, 0.0, 0.0]), still),
            WristSegment(motion.lifting, np.array([0.0, 0.0, motion.lift, 0.0, 0.0, 0.0]), still),
            WristSegment(motion.hold, still, still),
            WristSegment(motion.shaking, still, shake, motion.shake.frequency),
        ]
        return wrist_set_points(segments, timestep, load, gravity, servo_of(self.study.arm, load))

    def _physics(self, control: Control | None) -> PhysicsSettings:
        physics = self.study.physics
        if control is None:
            return physics
        gravity = None if control.gravity is None else (0.0, 0.0, -control.gravity)
        changed = {"timestep": control.timestep, "cone": control.cone, "gravity": gravity}
        return physics.model_copy(update={key: value for key, value in changed.items() if value is not None})

    def _base(self, thing: str, physics: PhysicsSettings) -> tuple[mujoco.MjModel, Stage, Scenario, Grasp]:
        key = (thing, physics.model_dump_json())
        if key not in self._made:
            name = self.study.hands[self.hand].format(object=thing)
            scenario, path = load_scenario(name)
            approach = Phase(name="approach", seconds=1.0, wrist="approach")
            protocol = TrialProtocol(version=1, physics=physics, phases=(approach,), reference="approach")
            scene = make_stage(scenario, protocol, self.spec.side, path.parent)
            model = compile_scene(self.spec, scene)
            set_wrist_servo(model, servo_of(self.study.arm, wrist_load(model)))
            self._made[key] = model, scene, scenario, load_grasp(scenario.grasp, self.spec)
        return self._made[key]


def servo_of(arm: SpringArm, load: float) -> WristServo:
    """The spring that carries a hand of that mass, kg."""
    stiffness = np.array([arm.stiffness] * 3 + [arm.rotation] * 3)
    return WristServo(stiffness, np.array([arm.inertia + load] * 3 + [arm.turning] * 3))
