"""One trial with the arm in the loop: approach on its spring, close by a policy, lift, hold and shake.

The arm and the hand are backends behind their guards, as in the lab's cell; what they do is decided from what they
report. Only the verdict, and the forces on the object, are looked up in the simulation.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import mujoco
import numpy as np

from allegro_twin import ArmReflex, ConfigError, HandFault, HandState, interleave, run
from allegro_twin.cell.arm import ArmWithHand, SetpointMotion, Smoothing, Stiffness, make_arm_with_hand
from allegro_twin.cell.motion import ArmGuide, GuidedImpedance
from allegro_twin.control import PD, GravityFeedforward, PositionControl, SetPoint
from allegro_twin.files import data_root, parse_settings
from allegro_twin.grasping import PhysicsSettings, Scenario, TrialProtocol, make_stage
from allegro_twin.hands import load_gains, load_spec
from allegro_twin.kinematics import Pose, hand_kinematics
from allegro_twin.types import Array, Vector
from studies.preemption.arm.grasps import PreparedGrasp, arm_of, placed_content, read_prepared
from studies.preemption.measures import Measures
from studies.preemption.policies import Seen, begins, due
from studies.preemption.protocol import ArmStudy, TimedPolicy
from studies.preemption.scenes import Job

_LOOK = 2
"""Periods from one look at the contacts to the next, until the thing is up."""
_FAR = 10.0
"""m. Where nothing is that has not diverged."""
_LONGEST = 20.0
"""s. No trial is longer."""


class ArmBench:
    """Makes trials of one hand on the arm. Raises ConfigError for an object for which no grasp is prepared."""

    def __init__(self, study: ArmStudy, hand: str) -> None:
        self.study, self.hand = study, hand
        self.spec = load_spec(hand)
        self.arm = arm_of(study, hand)
        self.prepared = read_prepared(hand)
        self._made: dict[tuple[str, str], _Scene] = {}

    def rows(self, jobs: list[Job]) -> list[dict[str, Any]]:
        """The rows of some trials, in their order."""
        return [_Trial(self, job).row() for job in jobs]

    def scene(self, job: Job) -> _Scene:
        """The scene of a trial: compiled once for each object, contact model and step of physics."""
        case, control = job.case, job.control
        physics = self.study.physics.model_dump(exclude_none=True)
        contacts = self.study.strata.contacts[case.contact].model_dump(exclude_none=True, exclude={"friction"})
        timestep = {} if control is None or control.timestep is None else {"timestep": control.timestep}
        settings = PhysicsSettings(**(physics | contacts | timestep))
        key = case.object, settings.model_dump_json()
        if key not in self._made:
            self._made[key] = self._scene(case.object, settings)
        return self._made[key]

    def _scene(self, name: str, physics: PhysicsSettings) -> _Scene:
        if name not in self.prepared:
            raise ConfigError(f"{name}: no grasp of {self.hand} is prepared: python -m studies.preemption prepare")
        ready, one = self.prepared[name], self.study.objects[name]
        wrist = {"position": (0.0, 0.0, 0.1), "facing": (0.0, 0.0, -1.0), "fingers": (1.0, 0.0, 0.0)}
        content = {
            "objects": [placed_content(name, one)], "friction": 1.0, "grasp": "prepared", "hand": self.hand,
            "side": "right", "wrist": wrist | {"retreat": (0.0, 0.0, 0.1)}, "protocol": "lift",
        }  # fmt: skip
        approach = {"name": "approach", "seconds": 1.0, "wrist": "approach"}
        timeline = parse_settings(TrialProtocol, {"version": 1, "phases": [approach], "reference": "approach"}, name)
        stage = make_stage(parse_settings(Scenario, content, name), timeline, "right", data_root())
        arm, period = self.arm, self.study.period
        robot = make_arm_with_hand(
            arm.model, self.spec, objects=stage.objects, posture=ready.posture, hand_posture=ready.preshape,
            friction=1.0, physics=physics.physics(), periods=(period, period), collision=arm.collision,
        )  # fmt: skip
        return _Scene(robot, name, ready, 2.0 * float(stage.objects[0].grasp_object.half_extents().min()))


class _Scene:
    """The arm, the hand and the object, and what is known of them before a trial."""

    def __init__(self, robot: ArmWithHand, name: str, ready: PreparedGrasp, width: float) -> None:
        self.robot, self.ready, self.width = robot, ready, width
        model = robot.world.model
        self.body = model.body(name).id
        self.address = int(model.jnt_qposadr[model.body_jntadr[self.body]])
        self.rest = model.qpos0[self.address : self.address + 7].copy()
        weld = model.body_weldid[model.geom_bodyid]
        self.of_object = weld == self.body
        self.of_world = weld == 0

    def place(self, x: float, y: float, yaw: float, friction: float) -> None:
        """Where the object stands from the next reset on, and how slippery everything is."""
        model, turned = self.robot.world.model, np.zeros(4)
        about = np.array([np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0)])
        mujoco.mju_mulQuat(turned, about, self.rest[3:])
        model.qpos0[self.address : self.address + 7] = [self.rest[0] + x, self.rest[1] + y, self.rest[2], *turned]
        model.geom_friction[:, 0] = friction

    def touch(self) -> tuple[float, bool]:
        """The sum of normal forces between hand and object, N, and whether the object touches the table."""
        data, model = self.robot.world.data, self.robot.world.model
        pairs = data.contact.geom[: data.ncon]
        if not len(pairs):
            return 0.0, False
        mine = self.of_object[pairs]
        other = np.where(mine[:, 0], pairs[:, 1], pairs[:, 0])
        table = mine.any(axis=1) & self.of_world[other]
        force, total = np.zeros(6), 0.0
        for contact in np.flatnonzero(mine.any(axis=1) & ~table).tolist():
            mujoco.mj_contactForce(model, data, contact, force)
            total += abs(float(force[0]))
        return total, bool(table.any())

    def poses(self) -> tuple[Array, Array]:
        """Of palm and object: position and quaternion, world, (7,) each."""
        data, palm = self.robot.world.data, self.robot.world.model.body("palm_link").id
        return (
            np.concatenate([data.xpos[palm], data.xquat[palm]]),
            np.concatenate([data.xpos[self.body], data.xquat[self.body]]),
        )


class Leg(NamedTuple):
    """A straight way of the set-point from rest to rest, of minimum jerk, the orientation kept."""

    begin: Pose
    way: Vector
    """(3,), m, in the base's frame."""
    since: float
    seconds: float
    """s."""

    def at(self, t: float) -> Pose:
        s = min(max((t - self.since) / self.seconds, 0.0), 1.0)
        return Pose(self.begin.position + s**3 * (10.0 + s * (6.0 * s - 15.0)) * self.way, self.begin.rotation)

    def motion(self, t: float) -> SetpointMotion:
        s = min(max((t - self.since) / self.seconds, 0.0), 1.0)
        speed, curvature = 30.0 * s**2 * (1.0 - s) ** 2, 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
        still = np.zeros(3)
        return SetpointMotion(
            np.concatenate([speed / self.seconds * self.way, still]),
            np.concatenate([curvature / self.seconds**2 * self.way, still]),
        )


class Swing(NamedTuple):
    """From rest to rest along x, then y, then z, a third of the time each: A/ω² (1 - cos ωt) in whole periods."""

    pose: Pose
    acceleration: float
    """Peak, m/s²."""
    frequency: float
    """Hz."""
    since: float
    seconds: float
    """s, of all three."""

    def at(self, t: float) -> Pose:
        axis, phase, size = self._now(t)
        return Pose(self.pose.position + size * (1.0 - np.cos(phase)) * axis, self.pose.rotation)

    def motion(self, t: float) -> SetpointMotion:
        axis, phase, size = self._now(t)
        turn, still = 2.0 * np.pi * self.frequency, np.zeros(3)
        return SetpointMotion(
            np.concatenate([size * turn * np.sin(phase) * axis, still]),
            np.concatenate([size * turn**2 * np.cos(phase) * axis, still]),
        )

    def _now(self, t: float) -> tuple[Vector, float, float]:
        third, turn = self.seconds / 3.0, 2.0 * np.pi * self.frequency
        since = min(max(t - self.since, 0.0), self.seconds - 1e-9)
        number = int(since / third)
        whole = np.floor(third * self.frequency) / self.frequency
        within = since - number * third
        phase = turn * within if within < whole else 0.0
        return np.eye(3)[number], phase, self.acceleration / turn**2 if within < whole else 0.0


@dataclass(slots=True)
class ClosingPath:
    """The fingers from the pre-shape through the closed posture to the squeeze, once they begin."""

    ready: PreparedGrasp
    close: float
    squeeze: float
    """s."""
    begun: float = float("inf")
    frozen: bool = False
    _still: Vector = field(init=False)

    def __post_init__(self) -> None:
        self._still = np.zeros(len(self.ready.preshape))

    def begin(self, position: Vector) -> ClosingPath:  # A reference is asked with the position.
        return self

    def done(self, t: float) -> bool:
        return t >= self.begun + self.close + self.squeeze - 1e-9

    def __call__(self, t: float) -> SetPoint:
        ready = self.ready
        if self.frozen or t <= self.begun:
            return SetPoint(ready.preshape, self._still)
        place, velocity = ready.preshape, self._still
        for since, seconds, way in (
            (t - self.begun, self.close, ready.close - ready.preshape),
            (t - self.begun - self.close, self.squeeze, ready.squeeze - ready.close),
        ):
            s = min(max(since / seconds, 0.0), 1.0)
            place = place + s**3 * (10.0 + s * (6.0 * s - 15.0)) * way
            velocity = velocity + 30.0 * s**2 * (1.0 - s) ** 2 / seconds * way
        return SetPoint(place, velocity)


class _Trial:
    """One trial while it runs."""

    def __init__(self, bench: ArmBench, job: Job) -> None:
        assert isinstance(job.policy, TimedPolicy)
        self.bench, self.job, self.policy = bench, job, job.policy
        self.study, self.motion = bench.study, bench.study.motion
        self.scene = bench.scene(job)
        self.robot, self.kept = self.scene.robot, Measures()
        self.path = ClosingPath(self.scene.ready, self.policy.close, self.motion.squeeze)
        self.path.frozen = job.control is not None and job.control.frozen
        self.lift = float("inf")
        self.touched, self.phase = 0.0, "approach"
        self.felt: list[float] = []

    def row(self) -> dict[str, Any]:
        """What came of it."""
        case, scene = self.job.case, self.scene
        scene.place(case.x, case.y, case.yaw, case.friction)
        try:
            self.kept.why = self._run()
        except ArmReflex as error:
            self.kept.why = f"arm reflex while {self.phase}: {error.name}"
        except HandFault as error:
            self.kept.why = f"stopped while {self.phase}: {type(error).__name__}"
        row = self.kept.row(case, self.study.check, self.policy.close)
        return row | {"contact": case.contact, "closing_s": self.policy.close, "phase": self.phase}

    def _run(self) -> str:
        robot, motion, arm = self.robot, self.motion, self.bench.arm
        ready, spec, model = self.scene.ready, self.bench.spec, self.robot.model
        guide = ArmGuide(ready.posture, model)
        stiffness = Stiffness(arm.stiffness, arm.angular_stiffness)
        law = GuidedImpedance(model, guide, stiffness.diagonal(), Smoothing(), robot.compensation)
        gains = load_gains("default", spec)
        gravity = GravityFeedforward(hand_kinematics(spec).gravity_torque)
        grip = PD(self.path, gains, gravity) if "torque" in spec.commands else PositionControl(self.path)
        arms = run(robot.arm, law)
        hands = run(robot.hand, grip)
        goal = robot.flange_for(Pose(*ready.palm))
        begin = model.pose(ready.posture)
        way = goal.position - begin.position
        period, tick = self.study.period, 0
        before: Pose | None = None
        ends = list[float]()
        for turn, sample in interleave((arms, period), (hands, period)):
            if turn == 1:
                continue
            state = sample.state
            t = state.t
            if tick == 0:
                guide.path, guide.line = None, Leg(Pose(begin.position, goal.rotation), way, t, self.job.case.approach)
                guide.target.move(goal)
            tick += 1
            if not np.abs(robot.world.data.xpos[self.scene.body]).max() < _FAR:
                return "diverged"
            if t > _LONGEST:
                return "never lifted"
            here = model.pose(state.position)
            if self.lift == float("inf"):
                before = self._decide(state, here, goal, before)
                if self.lift == t:
                    self.phase = "lifting"
                    self.kept.marks["lift"] = self.scene.poses()
                    up = np.array([0.0, 0.0, motion.lift])
                    guide.line = Leg(goal, up, t, motion.lifting)
                    ends = [t + motion.lifting, t + motion.lifting + motion.hold]
                    ends.append(ends[-1] + motion.shaking)
            self._look(t, tick)
            if ends and t >= ends[0] - 1e-9 and self.phase == "lifting":
                if not self._held():
                    return "not lifted"
                self.kept.lifted, self.phase = t, "holding"
            elif self.phase == "holding":
                self.felt.append(-float(robot.wrench(state)[2]))
                if t >= ends[1] - 1e-9:
                    if not self._held():
                        return "lost in the hold"
                    self.kept.felt = float(np.mean(self.felt[-self.study.check.samples :]))
                    self.kept.at_hold(*self.scene.poses())
                    self.phase = "shaking"
                    shake, up = motion.shake, np.array([0.0, 0.0, motion.lift])
                    high = Pose(goal.position + up, goal.rotation)
                    guide.line = Swing(high, shake.acceleration, shake.frequency, t, motion.shaking)
            elif self.phase == "shaking" and t >= ends[2] - 1e-9:
                if not self._held():
                    return "lost in the shake"
                self.kept.at_end(*self.scene.poses())
                return ""
        return "cut off"

    def _decide(self, state: HandState, here: Pose, goal: Pose, before: Pose | None) -> Pose:
        """Whether the hand begins to close, and the arm to lift."""
        case, rest, t = self.job.case, self.study.arm.rest, state.t
        remaining = float(np.linalg.norm(here.position - goal.position))
        speed = 0.0 if before is None else float(np.linalg.norm(here.position - before.position)) / self.study.period
        late = t - case.approach
        settled = late >= -1e-9 and (
            (remaining <= rest.distance and speed <= rest.speed) or late >= rest.patience - 1e-9
        )
        looks = bool(due(self.policy.rate, np.array([case.phase]), t, self.study.period)[0])
        if looks and self.path.begun == float("inf"):
            seen = Seen(t, np.array([case.approach]), np.array([settled]), np.array([remaining]), np.array([speed]),
                        np.array([self.touched]), np.array([self.scene.width]), np.array([case.sigma]))  # fmt: skip
            if begins(self.policy, seen, self.policy.close)[0]:
                self.path.begun = self.kept.begun = t
                self.kept.pushed = self._gone()
                self.phase = "closing"
        if looks and settled and self.path.done(t):
            self.lift = t
        return here

    def _look(self, t: float, tick: int) -> None:
        """The forces on the object, until it is up."""
        approach = self.job.case.approach
        if tick % _LOOK == 0 and self.phase in ("approach", "closing", "lifting"):
            force, _ = self.scene.touch()
            self.kept.peak, self.touched = max(self.kept.peak, force), max(self.touched, force)
            if t <= approach and force > 0.0:
                self.kept.premature += _LOOK * self.study.period
                self.kept.impulse += force * _LOOK * self.study.period
        if t <= approach:
            self.kept.carried = self._gone()

    def _gone(self) -> float:
        """How far the object is along the table from where it stood, m."""
        address, model = self.scene.address, self.robot.world.model
        at = self.robot.world.data.xpos[self.scene.body, :2]
        return float(np.linalg.norm(at - model.qpos0[address : address + 2]))

    def _held(self) -> bool:
        force, on_table = self.scene.touch()
        rise = float(self.robot.world.data.xpos[self.scene.body, 2] - self.scene.rest[2])
        return force > 0.0 and not on_table and rise >= self.study.check.rise
