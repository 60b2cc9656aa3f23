"""Many short segments of a hand's recorded motion, played at once and open loop through one model of its drive."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import mujoco
import numpy as np
from mujoco import batch

from allegro_twin.sim.drivetrain import backlash, lugre_friction, parasitic_torque
from allegro_twin.sim.drivetrain.warmth import warmth
from allegro_twin.sim.hand_import.adapt import compile_model
from allegro_twin.sim.model.joints import as_slice
from allegro_twin.sim.model.scene import hand_spec
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

_NONE: Vector = np.zeros(0)
_UPRIGHT: Array = np.zeros((0, 3))
PARASITIC = ("bias_torque", "stiffness", "uneven_damping", "cogging_cosine", "cogging_sine", "cogging_periods",
             "ripple_cosine", "ripple_sine", "ripple_periods")  # fmt: skip
"""What a motor neither commands nor loses evenly to friction."""
WARMTH = ("cold_friction", "warm_up")
"""What friction has while a hand warms up."""
BEFORE = 6
"""Periods of commands that are still on their way when a piece begins: the longest delay."""

HISTORY = 100
"""Periods before a piece in which bristles that give far are followed: 0.3 s."""
SPRINGY = 3e-3
"""rad: bristles that give further are bent by where their joint came from. Of others noise hides that, and the torque
tells more. Ours."""


@dataclass(frozen=True, slots=True, eq=False)
class DriveParameters:
    """Parameters between a fraction of full PWM and a motion, (n,) each."""

    torque_constant: Vector
    """N·m at full PWM."""
    armature: Vector
    """kg·m²."""
    damping: Vector
    """N·m·s/rad."""
    frictionloss: Vector
    """N·m."""
    offset: Vector
    """What a reported position is too high by, rad."""
    delay: Vector
    """s."""
    mass_scale: Vector
    """Factor on the mass of the link that the joint moves."""
    stiction: Vector
    """F_s / F_c, for a player with bristles."""
    stribeck_speed: Vector
    """rad/s, likewise."""
    bristle: Vector
    """rad, likewise."""
    load_friction: Vector
    """What a motor's torque adds to dry friction, as a share of it, likewise."""

    backlash: Vector
    """rad, both ways together, for a player that is loose."""
    bias_torque: Vector = field(default_factory=lambda: _NONE)
    """N·m, for a player with parasitic torque, like the next eight; nothing without."""
    stiffness: Vector = field(default_factory=lambda: _NONE)
    """N·m/rad."""
    uneven_damping: Vector = field(default_factory=lambda: _NONE)
    """N·m·s/rad."""
    cogging_cosine: Vector = field(default_factory=lambda: _NONE)
    """N·m."""
    cogging_sine: Vector = field(default_factory=lambda: _NONE)
    """N·m."""
    cogging_periods: Vector = field(default_factory=lambda: _NONE)
    """Periods of the cogging in a turn."""
    ripple_cosine: Vector = field(default_factory=lambda: _NONE)
    """Share of the motor's torque."""
    ripple_sine: Vector = field(default_factory=lambda: _NONE)
    """Share of the motor's torque."""
    ripple_periods: Vector = field(default_factory=lambda: _NONE)
    """Periods of the ripple in a turn."""
    gear_compliance: Vector = field(default_factory=lambda: _NONE)
    """rad/(N·m), for a player that is loose; 0: teeth do not bend."""
    cold_friction: Vector = field(default_factory=lambda: _NONE)
    """Share by which friction and damping are larger when the motors are switched on, for a player that warms."""
    warm_up: Vector = field(default_factory=lambda: _NONE)
    """Time constant in which that falls, s, likewise; 0: it does not."""
    tilt: Array = field(default_factory=lambda: _UPRIGHT)
    """By how much the palm leans from what each recording says of gravity: a rotation of that in the palm's frame,
    (recordings, 3), rad; no row where it does not lean."""

    def __post_init__(self) -> None:
        for name in (*PARASITIC, *WARMTH, "gear_compliance"):
            if not len(getattr(self, name)):
                object.__setattr__(self, name, np.zeros(len(self.torque_constant)))

    def warmth(self, t: Array | float) -> Array:
        """Factor on friction and damping at times since the motors were switched on, (…, 1) s → (…, n)."""
        return warmth(self.cold_friction, self.warm_up, t)

    def changed(self, name: str, joints: list[int], by: float) -> Self:
        """Copy with one parameter increased by `by` at some joints."""
        values = np.array(getattr(self, name))
        values[joints] += by
        return replace(self, **{name: values})


class Segments(NamedTuple):
    """Pieces of recordings, all of the same length."""

    duty: Array
    """Fractions of full PWM, (w, BEFORE + k, n): BEFORE periods before the piece, then its own."""
    gravity: Array
    """In the palm frame, (w, 3), m/s²."""
    weight: Array
    """At the fingertips, (w, n), kg, as `Drive.tip_mass`."""
    acceleration: Array
    """Where it begins, (w, n), rad/s²."""
    push: Array
    """Fractions of full PWM around the row where it begins and BEFORE rows before that, as smooth as the acceleration,
    (w, BEFORE + 1, n)."""
    time: Vector
    """Since the motors were switched on, when it begins, (w,), s."""
    past: Array
    """Speeds in the HISTORY periods before it begins, (w, HISTORY, n), rad/s, the latest last."""


STEP = {False: 0.001, True: 0.0006}
"""s, by whether friction breaks away or links are loose. The damping of bristles is explicit: its steps are to be short
beside armature / σ₁, some 6 ms. A link falls through its play in 10."""


class OpenLoopPlayer:
    """Plays pieces without contacts: fingers on a palm that stands still, in time steps of `timestep`, s."""

    def __init__(
        self,
        spec: HandSpec,
        period: float,
        timestep: float | None = None,
        *,
        bristly: bool = False,
        loose: bool = False,
        parasitic: bool = False,
        warming: bool = False,
    ) -> None:
        """`bristly`: friction breaks away; otherwise it is Coulomb's. `loose`: there is backlash. `parasitic`: joints
        feel parasitic torque. `warming`: friction falls while the hand warms up. The time step is the longest near
        STEP."""
        self.spec, self._period, self.bristly, self.loose = spec, period, bristly, loose
        self.parasitic, self.warming = parasitic, warming
        self._steps = round(period / (timestep or STEP[bristly or loose]))
        self.timestep = period / self._steps
        self._model = _bare(spec, self.timestep, bristly, loose, parasitic)
        model = self._model
        joints = [model.joint(name) for name in spec.joints]
        self.qpos = as_slice([joint.qposadr[0] for joint in joints])
        self.dofs = as_slice([joint.dofadr[0] for joint in joints])
        self.motors = as_slice([model.actuator(name).id for name in spec.joints])
        self._links = [int(joint.bodyid[0]) for joint in joints]
        self._mass, self._inertia = model.body_mass.copy(), model.body_inertia.copy()
        names = [lugre_friction.friction_actuator(name) for name in spec.joints] if bristly else []
        self._friction = np.array([model.actuator(name).id for name in names], dtype=int)
        self.bristles = np.array(model.actuator_actadr[self._friction])
        names = [backlash.play_joint(name) for name in spec.joints] if loose else []
        self._plays = np.array([model.joint(name).id for name in names], dtype=int)
        names = [parasitic_torque.torque_actuator(name) for name in spec.joints] if parasitic else []
        self._strays = as_slice([model.actuator(name).id for name in names])
        self._scratch = mujoco.MjData(model)
        self._weights = [model.body(f"{finger.name}_weight").id for finger in spec.fingers]

    def play(
        self, drive: DriveParameters, position: Array, velocity: Array, segments: Segments, bend: Array | None = None
    ) -> Array:
        """Reported positions at the end of every period, (w, k, n), rad, from reported positions and speeds (w, n);
        `bend`: how much more the bristles are bent than `_bent` says, (w, n), rad."""
        found = np.empty((len(position), segments.duty.shape[1] - BEFORE, self.spec.n_joints))
        for weight in np.unique(segments.weight, axis=0):
            rows = np.flatnonzero((segments.weight == weight).all(axis=1))
            self._set(drive, weight)
            part = Segments(*(each[rows] for each in segments))
            more = np.zeros_like(position[rows]) if bend is None else bend[rows]
            found[rows] = self._played(drive, position[rows], velocity[rows], part, more)
        return found

    def finer(self) -> OpenLoopPlayer:
        """Player of the same drive at half the time step."""
        return OpenLoopPlayer(
            self.spec, self._period, self.timestep / 2.0, bristly=self.bristly, loose=self.loose,
            parasitic=self.parasitic, warming=self.warming,
        )  # fmt: skip

    def links(self, qpos: Array) -> Array:
        """Where the links are, (…, n), rad: their motors, and how far they lie from these."""
        motors: Array = qpos[..., self.qpos]
        return motors + qpos[..., self._model.jnt_qposadr[self._plays]] if self.loose else motors

    def prepared(self, drive: DriveParameters) -> mujoco.MjModel:
        """This player's model with a drive, no weight at its tips."""
        self._set(drive, np.zeros(self.spec.n_joints))
        return self._model

    def rub(self, drive: DriveParameters, duty: Vector, time: float) -> None:
        """Set the friction of the `prepared` model, with what motors at a fraction of full PWM, (n,), add, some time
        after they were switched on, s."""
        warm: Vector | float = 1.0
        if self.warming:
            warm = drive.warmth(time)
            self._model.dof_damping[self.dofs] = warm * drive.damping
            if not self.bristly:
                self._model.dof_frictionloss[self.dofs] = warm * drive.frictionloss
        if self.bristly and (drive.load_friction.any() or self.warming):
            dry = warm * drive.frictionloss + drive.load_friction * drive.torque_constant * np.abs(duty)
            shape = (drive.stiction, drive.stribeck_speed, drive.bristle)
            lugre_friction.set_friction(self._model, self._friction, dry, *shape, drive.armature)

    def stray(self, drive: DriveParameters, data: mujoco.MjData) -> None:
        """Set the parasitic torque of the next step of a simulation of the `prepared` model."""
        if self.parasitic:
            motor = drive.torque_constant * data.ctrl[self.motors]
            data.ctrl[self._strays] = parasitic_torque.torque(drive, data.qpos[self.qpos], data.qvel[self.dofs], motor)

    def late(self, delay: Vector) -> Array:
        """What each of the last BEFORE + 1 commands has of every time step of a period, (steps, BEFORE + 1, n)."""
        impulses = np.eye(BEFORE + 1)[:, :, None] * np.ones(len(delay))
        return self._late(impulses, delay)  # (steps, which command, n)

    def link_torque(self, position: Vector, velocity: Vector, acceleration: Vector, gravity: Vector) -> Vector:
        """Torque that moves the links alone, as they are set, (n,), N·m."""
        data = self._scratch
        data.qpos[self.qpos], data.qvel[self.dofs], data.qacc[self.dofs] = position, velocity, acceleration
        self._model.opt.gravity[:] = gravity
        mujoco.mj_inverse(self._model, data)
        return np.array(data.qfrc_inverse[self.dofs])

    def links_only(self, mass_scale: Vector, weight: Vector) -> None:
        """Prepare for `link_torque`: no motors."""
        zero, one = np.zeros(self.spec.n_joints), np.ones(self.spec.n_joints)
        self._set(DriveParameters(zero, zero, zero, zero, zero, zero, mass_scale, one, one, one, zero, zero), weight)
        self._scratch = mujoco.MjData(self._model)

    def _set(self, drive: DriveParameters, weight: Vector) -> None:
        model = self._model
        model.dof_armature[self.dofs] = drive.armature
        model.dof_damping[self.dofs] = drive.damping
        model.dof_frictionloss[self.dofs] = 0.0 if self.bristly else drive.frictionloss
        if self.bristly:
            shape = (drive.stiction, drive.stribeck_speed, drive.bristle)
            lugre_friction.set_friction(model, self._friction, drive.frictionloss, *shape, drive.armature)
        model.actuator_gainprm[self.motors, 0] = drive.torque_constant
        model.body_mass[self._links] = self._mass[self._links] * drive.mass_scale
        model.body_inertia[self._links] = self._inertia[self._links] * drive.mass_scale[:, None]
        for body, finger in zip(self._weights, self.spec.fingers, strict=True):
            model.body_mass[body] = weight[list(finger.joints)].sum() + _NOTHING
        mujoco.mj_setConst(model, mujoco.MjData(model))
        if self.loose:
            backlash.set_backlash(model, self._plays, drive.backlash, drive.gear_compliance)

    def _played(
        self, drive: DriveParameters, position: Array, velocity: Array, segments: Segments, more: Array
    ) -> Array:
        sims = batch.Batch(self._model, len(position), 1)
        sims.expand("opt.gravity")[:] = segments.gravity
        sims.bind("qpos")[:, self.qpos] = position - drive.offset
        sims.bind("qvel")[:, self.dofs] = velocity
        if self.loose:
            gap = self._gap(drive, position, velocity, segments)
            sims.bind("qpos")[:, self.qpos] -= gap
            sims.bind("qpos")[:, self._model.jnt_qposadr[self._plays]] = gap
        if self.bristly:
            bent = self._bent(drive, position, velocity, segments)
            sims.bind("act")[:, self.bristles] = bent + more
        control = self._late(segments.duty, drive.delay)
        ctrl, qpos, qvel = (sims.bind(name) for name in ("ctrl", "qpos", "qvel"))
        rubbing = (
            lugre_friction.BatchedFriction(sims, self._friction)
            if self.bristly and (drive.load_friction.any() or self.warming)
            else None
        )
        share = drive.load_friction * drive.torque_constant
        found = np.empty((segments.duty.shape[1] - BEFORE, *position.shape))
        if self.warming:
            damping = sims.expand("dof_damping")
            dry_friction = None if self.bristly else sims.expand("dof_frictionloss")
        warm: Array = np.ones(1)
        for k in range(len(found)):
            if self.warming:
                warm = drive.warmth(segments.time[:, None] + k * self._period)
                damping[:, self.dofs] = warm * drive.damping
                if dry_friction is not None:
                    dry_friction[:, self.dofs] = warm * drive.frictionloss
            for step in range(self._steps):
                now = control[k * self._steps + step]
                ctrl[:, self.motors] = now
                if rubbing is not None:
                    dry = drive.frictionloss * warm + share * np.abs(now)
                    rubbing.set(dry, drive.stiction, drive.bristle, drive.armature)
                if self.parasitic:
                    angle, speed = qpos[:, self.qpos], qvel[:, self.dofs]
                    motor = drive.torque_constant * now
                    ctrl[:, self._strays] = parasitic_torque.torque(drive, angle, speed, motor)
                sims.step()
            found[k] = self.links(qpos)
        return np.asarray(np.swapaxes(found, 0, 1) + drive.offset)

    def _gap(self, drive: DriveParameters, position: Array, velocity: Array, segments: Segments) -> Array:
        """How far the links lie from their motors where pieces begin, (w, n), rad: at the tooth that pushes them. Of
        reported positions: an offset that a fit could choose would be one with which pieces begin well."""
        motion = zip(position, velocity, segments.acceleration, segments.gravity, strict=True)
        data, found = self._scratch, []
        for row in motion:
            self.link_torque(*row)
            # Of the links alone: what holds a motor's own inertia and friction does not pass the teeth.
            links = data.qfrc_inverse + data.qfrc_passive + data.qfrc_constraint
            found.append(links[self.dofs] - drive.armature * row[2])
        half = np.maximum(drive.backlash, backlash.SMALLEST) / 2.0
        return np.asarray(-half * np.sign(found) - drive.gear_compliance * found)

    def _bent(self, drive: DriveParameters, position: Array, velocity: Array, segments: Segments) -> Array:
        """How far the bristles are bent where pieces begin, (w, n), rad: as in steady motion of a joint that moves, and
        by what its motor's torque leaves for them where it creeps or sticks: there steady motion says nothing, and a
        wrong guess is a joint that breaks away at another time, or to the other side. Those that give by more than
        SPRINGY are followed through the periods before."""
        at = BEFORE - drive.delay / self._period
        floor = np.clip(at.astype(int), 0, BEFORE - 1)
        joints, part = np.arange(len(at)), np.clip(at - floor, 0.0, 1.0)
        before, after = segments.push[:, floor, joints], segments.push[:, floor + 1, joints]
        push = drive.torque_constant * (before + part * (after - before))
        motion = zip(position - drive.offset, velocity, segments.acceleration, segments.gravity, strict=True)
        # Armature is in it, and what the model itself holds against a motion: damping, and the bristles' springs at 0.
        held = push - np.array([self.link_torque(*row) for row in motion])
        if self.parasitic:
            held = held + parasitic_torque.torque(drive, position - drive.offset, velocity, push)
        dry = drive.frictionloss + drive.load_friction * np.abs(push)
        if self.warming:
            dry = dry + drive.frictionloss * (drive.warmth(segments.time[:, None]) - 1.0)
        sticking = drive.bristle * np.clip(held / np.maximum(dry * drive.stiction, 1e-6), -1.0, 1.0)
        steady = lugre_friction.steady_deflection(drive.stiction, drive.stribeck_speed, drive.bristle, velocity)
        moving = 1.0 - np.exp(-np.square(velocity / _SLIDES))
        bent = np.asarray(moving * steady + (1.0 - moving) * sticking)
        if (drive.bristle > SPRINGY).any():
            past, shape = np.swapaxes(segments.past, 0, 1), (drive.stiction, drive.stribeck_speed, drive.bristle)
            came = lugre_friction.followed_deflection(*shape, past, self._period)[-1]
            bent = np.where(drive.bristle > SPRINGY, came, bent)
        return bent

    def _late(self, duty: Array, delay: Vector) -> Array:
        """What acts in every time step, (steps, w, n): its mean over the step, however the delay divides it."""
        k, h = duty.shape[1] - BEFORE, self._period / self._steps
        whole = np.concatenate([np.zeros_like(duty[:, :1]), np.cumsum(duty, axis=1)], axis=1)  # (w, BEFORE + k + 1, n)
        edges = np.arange(k * self._steps + 1)[:, None] * h - delay  # (steps + 1, n)
        at = np.clip(edges / self._period + BEFORE, 0.0, BEFORE + k)
        floor = np.minimum(at.astype(int), BEFORE + k - 1)
        part, joints = at - floor, np.arange(duty.shape[2])
        below, above = whole[:, floor, joints], whole[:, floor + 1, joints]
        total = below + part * (above - below)  # The integral of the duty up to each edge, periods.
        return np.asarray(np.swapaxes(np.diff(total, axis=1), 0, 1) * self._steps)


_STIFF = 0.999
"""Impedance of dry friction: with it a joint creeps as little as with the two noslip iterations of a scene, at half
their cost (docs/results/identification.md)."""
_SLIDES = 0.15
"""rad/s. Ours: at this speed bristles of 2 mrad are bent anew in 13 ms."""
_NOTHING = 1e-9  # kg: a body without mass cannot be given one later.


def _bare(spec: HandSpec, timestep: float, bristly: bool, loose: bool, parasitic: bool) -> mujoco.MjModel:
    """The hand's links and joints, without anything that touches or is looked at."""
    hand = hand_spec(replace(spec, drive=None))
    for finger in spec.fingers:
        tip = hand.site(finger.tip)
        weight = tip.parent.add_body(name=f"{finger.name}_weight", pos=tip.pos)
        weight.mass, weight.inertia, weight.explicitinertial = _NOTHING, np.full(3, 1e-5 * _NOTHING), True
        weight.ipos = np.zeros(3)  # Without it MuJoCo puts the mass at `pos` once more.
    for parts in (hand.geoms, hand.sensors, hand.excludes, hand.meshes, hand.materials):
        for part in list(parts):
            hand.delete(part)
    for name in spec.joints:
        motor, joint = hand.actuator(name), hand.joint(name)
        joint.solimp_friction = [_STIFF, _STIFF, *joint.solimp_friction[2:]]
        if bristly:
            lugre_friction.add_friction(hand, name)
        if loose:
            backlash.add_backlash(hand, name, backlash.SMALLEST)
        motor.ctrllimited = motor.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
    for name in spec.joints if parasitic else ():  # After those of friction, which stand one after the other.
        parasitic_torque.add_torque(hand, name)
    hand.option.timestep, hand.option.noslip_iterations = timestep, 0
    hand.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # With dry friction alone to solve for it ends where Newton does, to 2e-8 rad in 0.3 s, in 0.7 of the time.
    # Teeth are harder: there Newton's is the faster one.
    hand.option.solver = mujoco.mjtSolver.mjSOL_NEWTON if loose else mujoco.mjtSolver.mjSOL_PGS
    hand.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return compile_model(hand)
