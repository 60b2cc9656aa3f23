"""Hidden hands: drawn motors, gears, mounts and contacts behind the virtual bus, in any scene.

Scenes, links and contacts are MuJoCo's; motors and gears are `motor_laws`, integrated at `STEP` beside them. A host
knows of a hand what its file says, and hears positions and torques from the bus.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from allegro_twin import Command, HandSpec, HandState, TorqueCommand
from allegro_twin.sim import SimBackend
from allegro_twin.spec import Side
from studies.rehearsal.motor_laws import HandPhysics, MotorLaws, N, Row

STEP = 2e-4
"""s, of laws and physics."""
VERSIONS = ("v3", "v4", "v5")


@dataclass(frozen=True, slots=True)
class HiddenHand:
    """One of the drawn hands, and how its fingertips touch."""

    number: int
    side: Side
    version: str
    physics: HandPhysics
    lean: Row
    """Rotation of the palm from where it is said to be, (3,), rad, in its own frame."""
    softness: float
    """Time constant of contacts, s."""
    friction: float
    """Factor on every sliding friction."""
    torsional: float
    """m"""
    impratio: float
    traits: tuple[str, ...]
    """What is unlike our own drives, in words."""


def draw_hand(number: int, seed: int) -> HiddenHand:
    """Hand `number` of a seed."""
    rng = np.random.default_rng((seed, 20261126, number))
    own = HandPhysics(
        rng.uniform(0.8, 1.2, N), rng.uniform(0.002, 0.0045, N), rng.uniform(0.05, 0.1, N),
        rng.uniform(0.01, 0.045, N), offset=rng.uniform(-0.01, 0.01, N), delay=float(rng.uniform(0.0005, 0.006)),
        mass=np.full(N, rng.uniform(0.9, 1.15)), noise=float(rng.uniform(2e-5, 2e-4)),
    )  # fmt: skip
    traits = []
    if rng.random() < 0.5:
        own.ratio, own.bristle = rng.uniform(1.2, 1.7, N), float(rng.uniform(4e-4, 1e-3))
        traits.append("friction that breaks away")
    if rng.random() < 0.5:
        own.load = rng.uniform(0.0, 0.06, N)
        traits.append("friction by load")
    if rng.random() < 0.4:
        own.uneven = rng.uniform(0.05, 0.2) * rng.choice([-1.0, 1.0], N)
        traits.append("friction by direction")
    if rng.random() < 0.4:
        own.cogging, own.phase = rng.uniform(0.0, 0.005, N), rng.uniform(0.0, 2.0 * np.pi, N)
        own.teeth = rng.integers(4, 16, N).astype(float)
        traits.append("cogging")
    if rng.random() < 0.4:
        own.cable = rng.uniform(-0.012, 0.012, N)
        traits.append("cables")
    if rng.random() < 0.4:
        own.cold, own.warming = float(rng.uniform(0.1, 0.3)), float(rng.uniform(5.0, 30.0))
        traits.append("warmth")
    if rng.random() < 0.2:
        own.play, own.spring, own.bristle = rng.uniform(0.002, 0.006, N), float(rng.uniform(15.0, 60.0)), 0.0
        traits.append("play with teeth that bend")
    if rng.random() < 0.3:
        own.constant[int(rng.integers(N))] *= 0.7
        traits.append("a weak motor")
    axis = rng.normal(size=3)
    lean = float(rng.choice([0.0, rng.uniform(0.005, 0.035)])) * axis / np.linalg.norm(axis)
    if lean.any():
        traits.append("a leaning mount")
    return HiddenHand(
        number, "left" if number % 2 else "right", VERSIONS[number % len(VERSIONS)], own, lean,
        float(rng.uniform(0.003, 0.012)), float(rng.uniform(0.75, 1.2)), float(rng.uniform(0.003, 0.015)),
        float(rng.choice([10.0, 100.0])), tuple(traits),
    )  # fmt: skip


class HiddenBackend:
    """A hidden hand in the scene of a simulation, as a backend that takes torques in parts of full PWM, 1 for 1 N·m."""

    live = False
    every_step = True

    def __init__(self, inner: SimBackend, hand: HiddenHand) -> None:
        self._inner, self.hand, self._laws = inner, hand, MotorLaws(hand.physics, STEP)
        self._rng = np.random.default_rng((hand.number, 7))
        self.substeps = inner.substeps
        self.model, self.data = inner.model, inner.data
        own, model, spec = hand.physics, inner.model, inner.spec
        self._limit = np.array(spec.actuation.torque_limit)
        self._dofs = np.array([model.joint(name).dofadr[0] for name in spec.joints])
        self._qpos = np.array([model.joint(name).qposadr[0] for name in spec.joints])
        model.dof_frictionloss[self._dofs], model.dof_damping[self._dofs] = 0.0, 0.0
        model.dof_solimp[self._dofs, :2] = 0.9999  # Dry friction holds, and does not creep.
        model.dof_armature[self._dofs] = 2e-5 if own.spring else own.armature
        for joint, name in enumerate(spec.joints):
            body = int(model.joint(name).bodyid[0])
            model.body_mass[body] *= own.mass[joint]
            model.body_inertia[body] *= own.mass[joint]
        root = model.body(spec.root).id
        turn, angle = np.zeros(4), float(np.linalg.norm(hand.lean))
        mujoco.mju_axisAngle2Quat(turn, hand.lean / angle if angle else np.array([1.0, 0.0, 0.0]), angle)
        mujoco.mju_mulQuat(model.body_quat[root], model.body_quat[root].copy(), turn)
        mujoco.mj_setConst(model, mujoco.MjData(model))
        inner.world.join(self)
        self._begin(inner.posture)

    @property
    def spec(self) -> HandSpec:
        return self._inner.spec

    @property
    def period(self) -> float:
        return self._inner.period

    @property
    def true_position(self) -> Row:
        """Where the links are, (n,), rad."""
        return self._inner.true_position

    def reset(self) -> HandState:
        return self._said(self._inner.reset())

    def write(self, command: Command) -> None:
        assert isinstance(command, TorqueCommand)
        due = self._steps + round(self.hand.physics.delay / STEP)
        self._coming.append((due, np.clip(command.torque, -self._limit, self._limit)))

    def read(self) -> HandState:
        return self._said(self._inner.read())

    def close(self) -> None:
        self._duty = np.zeros(N)

    # A member of the world.

    def lay(self) -> None:
        self._begin(self._inner.posture)

    def begin_period(self) -> None:
        return

    def before_step(self, step: int) -> None:
        data, model = self._inner.data, self._inner.model
        while self._coming and self._coming[0][0] <= self._steps:
            self._duty = self._coming.pop(0)[1]
        torque, slides = self._laws.step(self._duty, data.qpos[self._qpos], data.qvel[self._dofs], self._steps * STEP)
        if self._laws.link_friction:
            model.dof_frictionloss[self._dofs] = slides
        data.qfrc_applied[self._dofs] = torque
        self._steps += 1

    def _begin(self, posture: Row) -> None:
        self._laws.reset(np.array(posture))
        self._coming: list[tuple[int, Row]] = []
        self._duty, self._steps = np.zeros(N), 0

    def _said(self, state: HandState) -> HandState:
        """What the hand's encoders and electronics say."""
        own = self.hand.physics
        heard = state.position + own.offset + own.noise * self._rng.standard_normal(N)
        given = self._duty.copy()
        for array in (heard, given):
            array.setflags(write=False)
        return replace(state, position=heard, torque=given)
