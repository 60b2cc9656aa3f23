"""A hand's drive in its simulation: what is compiled into the model, and what happens at every step."""

from __future__ import annotations

from collections import deque
from typing import Any

import mujoco
import numpy as np

from allegro_twin.kinematics.orientation import rotate_vector
from allegro_twin.sim.drivetrain import backlash, lugre_friction, parasitic_torque
from allegro_twin.sim.drivetrain.warmth import warmth
from allegro_twin.spec import HandSpec
from allegro_twin.spec.drivetrain import Ailment, Drive
from allegro_twin.types import Vector

_WEIGHT = 0.005  # m, radius of a weight at a fingertip.


def build_drive(hand: mujoco.MjSpec, spec: HandSpec, drive: Drive) -> None:
    """Edit a hand's MjSpec: strength, friction that breaks away, parasitic torque, masses, weights at fingertips."""
    for index, name in enumerate(spec.joints):
        motor, limit = hand.actuator(name), spec.actuation.torque_limit[index] * drive.strength[index]
        motor.gainprm[0] = drive.strength[index]
        motor.forcerange = [-limit, limit]
        if drive.bristle[index] > 0.0:
            lugre_friction.add_friction(hand, name)
        link = hand.joint(name).parent
        if drive.backlash[index] > 0.0:
            backlash.add_backlash(hand, name, drive.backlash[index])
        if drive.parasitic:
            parasitic_torque.add_torque(hand, name)
        if drive.mass_scale[index] != 1.0:
            link.mass *= drive.mass_scale[index]
            link.inertia *= drive.mass_scale[index]
            link.fullinertia *= drive.mass_scale[index]
    for finger in spec.fingers:
        mass = float(drive.tip_mass[list(finger.joints)].sum())
        if mass > 0.0:
            tip = hand.site(finger.tip)
            weight = tip.parent.add_body(name=f"{finger.name}_weight", pos=tip.pos)
            weight.mass, weight.inertia = mass, np.full(3, 0.4 * mass * _WEIGHT**2)
            weight.explicitinertial, weight.ipos = True, np.zeros(3)  # Without it the mass is at `pos` once more.


def drives_joints(spec: HandSpec, model: mujoco.MjModel) -> bool:
    """Whether each motor turns a joint of its own, rather than a tendon."""
    return set(spec.joints) <= {model.joint(k).name for k in range(model.njnt)}


class Drivetrain:
    """State of a drive while time passes."""

    def __init__(self, spec: HandSpec, drive: Drive, model: mujoco.MjModel, motors: slice | list[int]) -> None:
        self._drive, self._model, self._motors, self._names = drive, model, motors, spec.joints
        self._late = round(drive.delay / model.opt.timestep)
        self._dofs = np.array([model.joint(name).dofadr[0] for name in spec.joints])
        self._dry, self._armature = spec.actuation.frictionloss, spec.actuation.armature
        self._soft = np.flatnonzero(drive.bristle > 0.0)
        self._elements = np.array(
            [model.actuator(lugre_friction.friction_actuator(spec.joints[k])).id for k in self._soft], dtype=int
        )
        self._rub(self._dry)
        plays = np.flatnonzero(drive.backlash > 0.0)
        if drive.gear_compliance[plays].any():
            ids = np.array([model.joint(backlash.play_joint(spec.joints[k])).id for k in plays])
            backlash.set_backlash(model, ids, drive.backlash[plays], drive.gear_compliance[plays])
        self._plays = plays, [int(model.joint(backlash.play_joint(spec.joints[k])).qposadr[0]) for k in plays]
        self._joints = [model.joint(name).id for name in spec.joints]
        # What went wrong: what motors still give, how far encoders have moved, and how fast they do, rad and rad/s.
        self._share, self._moved, self._drift = np.ones((3, spec.n_joints)) * [[1.0], [0.0], [0.0]]
        self._loaded = bool(drive.load_friction.any())
        self._warming = drive.warming
        self._damping = model.dof_damping[self._dofs].copy()
        self._strays: list[int] = []
        if drive.parasitic:
            self._strays = [model.actuator(parasitic_torque.torque_actuator(name)).id for name in spec.joints]
            self._angles = np.array([model.joint(name).qposadr[0] for name in spec.joints])
        self.reset()

    def suffer(self, what: Ailment, joint: int, amount: float) -> None:
        """Something goes wrong with a joint, for good: `amount` as AILMENTS has it. Raises ConfigError for a joint that
        is to be loose and has no play in the model."""
        match what:
            case "weak":
                self._share[joint] = amount
            case "stuck" | "friction":
                self._dry = self._dry.copy()
                self._dry[joint] += amount
                self._rub(self._dry)
            case "encoder_step":
                self._moved[joint] += amount
            case "encoder_drift":
                self._drift[joint] += amount
            case "loose":
                backlash.loosen_joint(self._model, self._names[joint], amount)
            case "payload":
                body = int(self._model.jnt_bodyid[self._joints[joint]])
                self._model.body_mass[body] += amount
                mujoco.mj_setConst(self._model, mujoco.MjData(self._model))

    def rub(self, dry: float) -> None:
        """Set the dry friction of every joint, N·m, as that of motion where it breaks away."""
        self._dry = np.full(len(self._dry), dry)
        self._rub(self._dry)

    def reset(self) -> None:
        """Begin anew: no command is on its way, and the noise is the same again; what went wrong stays."""
        self._noise = np.random.default_rng(self._drive.seed)
        self._coming: deque[tuple[int, Vector]] = deque()
        self._step = 0

    def save(self) -> tuple[Any, ...]:
        """Copy of the state that decides how it goes on: time, commands on their way, noise, and what went wrong."""
        wrong = self._dry, self._share.copy(), self._moved.copy(), self._drift.copy()
        return self._step, tuple(self._coming), self._noise.bit_generator.state, *wrong

    def restore(self, state: tuple[Any, ...]) -> None:
        """Go on from what `save` returned."""
        self._step, coming, self._noise.bit_generator.state, self._dry, *wrong = state
        self._coming = deque(coming)
        for kept, saved in zip((self._share, self._moved, self._drift), wrong, strict=True):
            kept[:] = saved
        self._rub(self._dry)

    def command(self, torque: Vector) -> None:
        """A torque (n,), N·m, set out."""
        self._coming.append((self._step + self._late, torque))

    def step(self, data: mujoco.MjData) -> None:
        """One physics step is about to pass."""
        while self._coming and self._coming[0][0] <= self._step:
            data.ctrl[self._motors] = self._coming.popleft()[1] * self._share
        if self._loaded or self._warming:
            self._rub(self._warmed(self._dry) + self._load(data))
        if self._warming:
            self._model.dof_damping[self._dofs] = self._warmed(self._damping)
        if self._strays:
            angle, speed = data.qpos[self._angles], data.qvel[self._dofs]
            motor = self._drive.strength * data.ctrl[self._motors]
            data.ctrl[self._strays] = parasitic_torque.torque(self._drive, angle, speed, motor)
        self._step += 1
        self._moved += self._drift * self._model.opt.timestep

    def _warmed(self, cold: Vector) -> Vector:
        """Friction or damping now, (n,)."""
        if not self._warming:
            return cold
        time = self._step * self._model.opt.timestep
        return np.asarray(cold * warmth(self._drive.cold_friction, self._drive.warm_up, time))

    def _load(self, data: mujoco.MjData) -> Vector:
        """Friction by the motors' torques, (n,), N·m."""
        return np.asarray(self._drive.load_friction * np.abs(data.actuator_force[self._motors]))

    def _rub(self, dry: Vector) -> None:
        """Set dry friction, (n,), N·m."""
        drive, soft = self._drive, self._soft
        self._model.dof_frictionloss[self._dofs] = np.where(drive.bristle > 0.0, 0.0, dry)
        if len(soft):
            rows = (each[soft] for each in (dry, drive.stiction, drive.stribeck_speed, drive.bristle, self._armature))
            lugre_friction.set_friction(self._model, self._elements, *rows)

    def reported_gravity(self, gravity: Vector) -> Vector:
        """What the hand says of gravity in its palm's frame, (3,), m/s²."""
        tilt = self._drive.tilt
        return rotate_vector(gravity, -tilt) if tilt.any() else gravity

    def reported(self, position: Vector, data: mujoco.MjData) -> Vector:
        """What the encoders say of joint positions (n,), rad."""
        drive, (loose, plays) = self._drive, self._plays
        seen: Vector = position + drive.encoder_offset + self._moved
        seen[loose] += data.qpos[plays]
        seen += drive.encoder_noise * self._noise.standard_normal(len(seen))
        coarse = drive.quantisation > 0.0
        return np.where(coarse, np.rint(seen / np.where(coarse, drive.quantisation, 1.0)) * drive.quantisation, seen)
