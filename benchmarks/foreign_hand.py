"""A hidden hand in plain MuJoCo with physics that no drive of the package has, behind the real protocol.

Nothing of `allegro_twin.sim` is in it: links are the hand's MJCF without its losses; motors, friction, cogging, cables,
warmth and teeth are integrated here, at 0.1 ms. What it tells of itself goes through the v4 codec.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from allegro_twin.app.config import RunConfig
from allegro_twin.backend import torque_of
from allegro_twin.drivers.can.config import CanSettings
from allegro_twin.drivers.can.opening import open_can
from allegro_twin.files.assets import data_root
from allegro_twin.kinematics.orientation import rotate_vector
from allegro_twin.loop import run, until
from allegro_twin.plugins import BackendContext
from allegro_twin.recording.recorder import record
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.motions.excitation import find_pose, rehearse
from allegro_twin.types import Command, HandState, Vector, frozen
from studies.rehearsal.motor_laws import HandPhysics, MotorLaws, Row

N = 16
STEP = 1e-4  # s
KINDS = ("plain", "lugre", "tilt", "tilt_each", "cogging", "direction", "warm", "teeth", "cable", "springs", "coupled",
         "ripple", "dahl")  # fmt: skip
"""What is unlike our own drives: nothing; friction that breaks away with a weak motor; a base that leans by 3°, as one
in the palm's frame, or another way in each recording; torque that comes again with the angle; friction of two
directions with heavier links; warmth with cogging and cables; teeth that bend; cables alone; springs; springs over
neighbouring joints, too; motors whose torque ripples with the angle; friction that gives by 15 mrad before it slides
(Dahl 1968)."""


@dataclass(slots=True)
class ForeignPhysics(HandPhysics):
    """What the rehearsal's hands do not have."""

    rate: Row = field(default_factory=lambda: np.zeros((N, N)))
    """Of springs, N·m/rad: torque of each joint by the angle of each."""
    rest: Row = field(default_factory=lambda: np.zeros(N))
    """Angles at which the springs pull nothing, rad."""
    ripple: tuple[tuple[float, float], ...] = ()
    """Share by which a motor's torque ripples, and how often in a turn."""


def draw(kind: str, seed: int) -> ForeignPhysics:
    """A hand of one kind."""
    rng = np.random.default_rng((seed, 977, KINDS.index(kind)))
    each = ForeignPhysics(
        rng.uniform(0.85, 1.15, N), rng.uniform(0.002, 0.004, N), rng.uniform(0.05, 0.1, N),
        rng.uniform(0.01, 0.045, N), offset=rng.uniform(-0.01, 0.01, N), delay=int(rng.integers(5, 60)) * STEP,
    )  # fmt: skip
    axis = rng.normal(size=(4, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    match kind:
        case "lugre":
            each.ratio, each.load, each.bristle = rng.uniform(1.3, 1.7, N), rng.uniform(0.02, 0.06, N), 8e-4
            each.constant[int(rng.integers(N))] *= 0.7
        case "tilt":
            each.lean[""] = np.radians(3.0) * axis[0]
        case "tilt_each":
            each.lean = {
                pose: np.radians(2.0) * a for pose, a in zip(("up", "palm-up", "side", "palm-down"), axis, strict=True)
            }
        case "cogging":
            each.cogging, each.phase = np.full(N, 0.005), rng.uniform(0.0, 2.0 * np.pi, N)
        case "direction":
            each.uneven, each.mass = 0.2 * rng.choice([-1.0, 1.0], N), np.full(N, 1.15)
        case "warm":
            each.ratio, each.bristle, each.cold = rng.uniform(1.3, 1.7, N), 8e-4, 0.3
            each.cogging, each.phase = np.full(N, 0.003), rng.uniform(0.0, 2.0 * np.pi, N)
            each.cable = 0.01 * rng.choice([-1.0, 1.0], N)
        case "teeth":
            each.play, each.spring = np.full(N, 0.008), 15.0
        case "springs" | "coupled":
            each.rate, each.rest = np.diag(rng.uniform(0.004, 0.02, N)), rng.uniform(-0.3, 1.2, N)
            if kind == "coupled":
                for joint in range(N - 1):
                    if joint % 4 < 3:  # Of one finger.
                        each.rate[joint, joint + 1] = each.rate[joint + 1, joint] = rng.uniform(-0.004, 0.004)
        case "ripple":
            each.ripple, each.phase = ((0.08, 9.0), (0.04, 27.0)), rng.uniform(0.0, 2.0 * np.pi, N)
        case "dahl":
            each.bristle = 0.015
        case "cable":
            each.cable = rng.uniform(-0.015, 0.015, N)
    return each


class Push(NamedTuple):
    """A force on a fingertip for a while."""

    begin: float
    """s"""
    seconds: float
    finger: int
    force: Vector
    """N, (3,), world."""


class Break(NamedTuple):
    """What goes wrong with a joint, from a time on."""

    name: str
    """`friction`, N·m more; `weak`, the share of its torque that a motor lacks; `payload`, kg at a link's centre."""
    joint: int
    amount: float
    begin: float
    """s"""


class ForeignHand:
    """The hand, as a backend that takes torques. `pushes`: what touches it; `breaks`: what goes wrong with it."""

    live = False

    def __init__(
        self,
        spec: HandSpec,
        physics: ForeignPhysics,
        gravity: Vector,
        period: float,
        seed: int,
        pushes: Sequence[Push] = (),
        breaks: Sequence[Break] = (),
    ) -> None:
        self._pushes, self._breaks = pushes, breaks
        self._spec, self._truth, self.period, self._seed = spec, physics, period, seed
        model = mujoco.MjModel.from_xml_path(str(data_root() / "models" / "mjcf" / f"{spec.name}.xml"))
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_ACTUATION)
        model.opt.timestep, model.opt.noslip_iterations = STEP, 0
        model.opt.gravity[:] = gravity
        self._dofs = np.array([model.joint(name).dofadr[0] for name in spec.joints])
        self._qpos = np.array([model.joint(name).qposadr[0] for name in spec.joints])
        model.dof_frictionloss[:], model.dof_damping[:] = 0.0, 0.0
        model.dof_solimp[:, :2] = 0.9999  # Dry friction holds, and does not creep.
        model.dof_armature[self._dofs] = 2e-5 if physics.spring else physics.armature
        for joint, name in enumerate(spec.joints):
            body = int(model.joint(name).bodyid[0])
            model.body_mass[body] *= physics.mass[joint]
            model.body_inertia[body] *= physics.mass[joint]
        mujoco.mj_setConst(model, mujoco.MjData(model))
        self._model, self._data = model, mujoco.MjData(model)
        self._tips = [model.site(finger.tip).id for finger in spec.fingers]
        self._jacobian = np.zeros((3, model.nv))
        self._laws = MotorLaws(deepcopy(physics), STEP)  # A joint that breaks is this hand's own.
        self._constant = np.ones(N)  # What its driver takes full PWM for, N·m, as an unknown hand's host does.
        self._begun = np.array((spec.lower + spec.upper) / 2.0)

    @property
    def spec(self) -> HandSpec:
        return self._spec

    def reset(self) -> HandState:
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[self._qpos] = self._begun
        self._due = sorted(self._breaks, key=lambda each: each.begin)
        self._laws.reset(self._begun)
        self._rng, self._ticks, self._steps = np.random.default_rng(self._seed), 0, 0
        self._coming: list[tuple[int, Vector]] = []
        self._duty = np.zeros(N)
        mujoco.mj_forward(self._model, self._data)
        return self._state()

    def write(self, command: Command) -> None:
        duty = torque_of(command, self._spec) / self._constant
        self._coming.append((self._steps + round(self._truth.delay / STEP), duty))

    def read(self) -> HandState:
        for _ in range(round(self.period / STEP)):
            while self._coming and self._coming[0][0] <= self._steps:
                self._duty = self._coming.pop(0)[1]
            self._step()
            self._steps += 1
        self._ticks += 1
        return self._state()

    def close(self) -> None:
        self._duty = np.zeros(N)

    def _break(self, each: Break) -> None:
        match each.name:
            case "friction":
                self._laws.physics.friction[each.joint] += each.amount
            case "weak":
                self._laws.physics.constant[each.joint] *= 1.0 - each.amount
            case "payload":
                self._model.body_mass[self._model.joint(self._spec.joints[each.joint]).bodyid[0]] += each.amount
            case _:
                raise ValueError(each.name)

    def _step(self) -> None:
        while self._due and self._due[0].begin <= self._steps * STEP:
            self._break(self._due.pop(0))
        data, now = self._data, self._steps * STEP
        angle, own = data.qpos[self._qpos], self._truth
        ripple = 1.0 + sum(share * np.sin(often * angle + own.phase) for share, often in own.ripple)
        torque, slides = self._laws.step(self._duty * ripple, angle, data.qvel[self._dofs], now)
        torque = torque - own.rate @ (angle - own.rest)
        if self._laws.link_friction:
            self._model.dof_frictionloss[self._dofs] = slides
        data.qfrc_applied[self._dofs] = torque
        for push in self._pushes:
            if push.begin <= now < push.begin + push.seconds:
                mujoco.mj_jacSite(self._model, data, self._jacobian, None, self._tips[push.finger])
                data.qfrc_applied += push.force @ self._jacobian
        mujoco.mj_step(self._model, data)

    def _state(self) -> HandState:
        said = self._data.qpos[self._qpos] + self._truth.offset + self._truth.noise * self._rng.standard_normal(N)
        return HandState(
            t=self._ticks * self.period, tick=self._ticks, position=frozen(said),
            velocity=frozen(self._data.qvel[self._dofs].copy()), torque=frozen(self._duty * self._constant),
            temperature=frozen(np.full(N, np.nan)), gravity=frozen(np.full(3, np.nan)),
        )  # fmt: skip


class _Place:
    """Where a hidden hand stands: what opens it in the place of a simulation."""

    def __init__(
        self, physics: ForeignPhysics, gravity: Vector, seed: int, pushes: Sequence[Push], breaks: Sequence[Break]
    ) -> None:
        self._physics, self._gravity, self._seed = physics, gravity, seed
        self._pushes, self._breaks = pushes, breaks

    def check(self, spec: HandSpec) -> None:
        """Any hand will do."""

    def simulate(self, settings: object, spec: HandSpec, step: float) -> Any:
        return ForeignHand(spec, self._physics, self._gravity, step, self._seed, self._pushes, self._breaks)


def recorded(
    kind: str, seed: int, poses: Sequence[str], seconds: Mapping[str, float], folder: Path, *,
    pushes: Sequence[Push] = (), breaks: Sequence[Break] = (), first: int = 0,
) -> list[Path]:  # fmt: skip
    """Excite a hand of one kind in some poses; a recording each. `pushes`, `breaks`: what touches it, and what goes
    wrong with it, in each; `first`: number of the first motion, of which every one is another."""
    physics, paths = draw(kind, seed), []
    for number, name in enumerate(poses, first):
        pose = find_pose(name, "right")
        backend: dict[str, Any] = {
            "kind": "can", "version": "v4", "interface": "allegro-virtual", "gravity": list(pose.gravity),
            "scene": {"kind": "sim"},
        }  # fmt: skip
        config = RunConfig.model_validate({"backend": backend, "controller": {"kind": "torque"}})
        assert isinstance(config.backend, CanSettings)
        lean = physics.lean.get(name, physics.lean.get("", np.zeros(3)))
        place = _Place(physics, rotate_vector(pose.gravity, lean), 31 * seed + number, pushes, breaks)
        rig = open_can(config.backend, BackendContext(config.hand, config.period, place.check, place.simulate))
        motion = rehearse(rig.spec, pose, 100 * seed + number, seconds[name]).excitation
        paths.append(folder / f"{name}_{number}.arrow")
        meta = {"calibration": dict(rig.calibration), "config": config.model_dump(mode="json")}
        for _ in record(until(seconds[name], run(rig, motion)), paths[-1], rig.spec, config.period, meta=meta):
            pass
        rig.close()
    return paths
