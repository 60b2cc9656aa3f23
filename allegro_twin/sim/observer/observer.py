"""One simulation that runs beside a hand, fed with the same commands and corrected by what the hand reports.

For every joint a steady Kalman filter with the states position, speed and disturbance, in the period T:

    q ← q + T v,    v ← e^(−BT/M) v + T d / M,    d ← d + random walk;    reported: q + noise

M: inertia seen at the joint, B: damping. The physics between two corrections is the engine's own, with all that couples
joints; the filter's gains alone are of the simple model. The disturbance is the torque that nobody commanded: a touch.
Of a joint at rest dry friction holds any torque up to its own, so the least that explains the reports is told: there
d ← d − (T / FORGET) d, or the engine's friction, which creeps under a load, would wind it up until nothing is held.

The hand's dry friction may creep, too, and faster than the model's: slower than REST a loaded joint goes on at some
mrad/s. That is no touch. So a joint at rest without bristles may go along its load at up to SOFT · load / inertia, as
much as its disturbance asks for.

Where friction has bristles (`lugre_friction`) they lose z |v| T / bristle in a period, so the noise of corrected
speeds, 7 mrad/s, would unbend them within 0.2 s of a rest, and the disturbance would hold what they held: 40 mN·m. So
bristles of joints at rest are springs, ż = v, as those of Dupont et al. 2002 (Single state elastoplastic
friction models) are before they break away.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.kinematics.orientation import rotate_vector
from allegro_twin.sim.model.joints import JointChange
from allegro_twin.sim.observer.kalman import JointKalman
from allegro_twin.sim.open_loop import BEFORE, PARASITIC, WARMTH, DriveParameters, OpenLoopPlayer
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

NOISE = 6e-5
"""rad, of a reported position, at least: half a count of a v4 hand, and what quiet encoders add."""
TORQUE, WALK = 3e-3, 2e-3  # N·m: of the model's torques, and how far a disturbance goes in a period.

REST = 0.03
"""rad/s: slower joints rest."""
CREEP = 0.02
"""rad/s over which friction without bristles changes its side."""
FORGET = 0.5
"""s. Ours: long beside the 60 ms in which a push is to be seen, short beside the 5 s in which 10 mN·m wound up."""
SOFT = 1.25 / 947.0
"""s: over the inertia at a joint the speed at which dry friction may creep under a load, 1/(N·m·s). MuJoCo's with its
usual solver parameters creeps by 1/947 (a stationary speed v, held by v d b / (1 - d), with d = 0.9 and b = 105/s)."""
CREEPS = (1.05, 10.5)
"""Gains, 1/(N·m·s) and 1/(N·m·s²), with which the speed of a creeping joint follows its disturbance: it takes 0.1 s."""
UNSURE = 0.25
"""Share of F_s by which bristles may hold another torque than the hand's. Ours: they are bent otherwise by up to 0.14
of it (docs/explanation/mirror.md)."""


class Estimate(NamedTuple):
    """Estimated state of all joints in one period."""

    predicted: Vector
    """Reported positions as expected before the report came, (n,), rad."""
    position: Vector
    """As corrected, without offsets, (n,), rad."""
    disturbance: Vector
    """Torque from outside, (n,), N·m."""
    velocity: Vector
    """As corrected, (n,), rad/s."""
    side: Vector
    """Dry friction over that in fast motion, with the sign of the speed, (n,)."""


class ModelChange(NamedTuple):
    """Differences of a hand from its file, (n,) each."""

    strength: Vector
    """Factor on the motors' torque."""
    friction: Vector
    """Dry friction beside that of the file, N·m."""
    payload: Vector
    """Mass at each link's centre of mass beside that of the file, kg; links by the joint that moves them."""
    offset: Vector
    """What a reported position is too high by beside what the file says, rad."""


class StateObserver:
    """A corrected simulation. Equal inputs give equal outputs, to the last bit."""

    def __init__(
        self,
        spec: HandSpec,
        drive: DriveParameters,
        period: float,
        *,
        bristly: bool = False,
        noise: Vector | None = None,
    ) -> None:
        """`noise`: standard deviation of what encoders report, (n,), rad; None, and at least: NOISE."""
        parasitic, warming = (any(getattr(drive, name).any() for name in names) for names in (PARASITIC, WARMTH))
        self._player = OpenLoopPlayer(spec, period, bristly=bristly, parasitic=parasitic, warming=warming)
        self._drive, self._file, self._time = drive, drive, 0.0
        nothing = np.zeros(spec.n_joints)
        self._change = ModelChange(nothing + 1.0, nothing, nothing, nothing)
        self._model = self._player.prepared(drive)
        self._data = mujoco.MjData(self._model)
        self._weights = self._player.late(drive.delay)  # (steps, BEFORE + 1, n), the latest last.
        self.noise: Vector = np.maximum(NOISE, np.zeros(spec.n_joints) if noise is None else noise)
        """Standard deviation of reported positions, (n,), rad."""
        self._kalman, self._inertia = self._filter(spec, drive, period)
        self._offset = drive.offset
        self._softness = SOFT * self._model.dof_invweight0[self._player.dofs]
        self._crept = np.zeros(spec.n_joints)
        self.period, self.torque_constant = period, drive.torque_constant
        self.held = UNSURE * drive.frictionloss * drive.stiction if bristly else np.zeros(spec.n_joints)
        """How far off friction that breaks away may be in a joint at rest, (n,), N·m."""
        self._links = [int(self._model.joint(name).bodyid[0]) for name in spec.joints]
        self._joints = [self._model.joint(name).id for name in spec.joints]
        ends = np.where(
            self._model.jnt_limited[self._joints, None], self._model.jnt_range[self._joints], [-np.inf, np.inf]
        )
        self._lower, self._upper = ends.T
        self._before = np.zeros((spec.n_joints, spec.n_joints))  # Whether a joint carries the link of another.
        for finger in spec.fingers:
            for place, joint in enumerate(finger.joints):
                self._before[joint, list(finger.joints[place:])] = 1.0

    def reset(self, position: Vector, time: float = 0.0) -> None:
        """Begin where the hand reports to be, (n,), rad, at rest, `time` s after its motors were switched on."""
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[self._player.qpos] = position - self._offset
        zero, self._time = np.zeros(len(position)), time
        self._crept = zero.copy()
        self._sent: deque[Vector] = deque([zero] * (BEFORE + 1), maxlen=BEFORE + 1)

    @property
    def spread(self) -> Vector:
        """Standard deviation of the disturbance that noise alone makes now, (n,), N·m."""
        return self._kalman.spread

    @property
    def expected(self) -> Vector:
        """Standard deviation of the last reports from what was predicted, (n,), rad."""
        return self._kalman.expected

    def noisier(self, noise: Vector) -> None:
        """From now on reports have this noise, (n,), rad."""
        self.noise = noise
        self._kalman.noisier(noise)

    def missed(self, duty: Vector, gravity: Vector, unsure: Vector) -> Estimate:
        """A period whose report was lost, in which a fraction of full PWM acted, (n,), known but for `unsure`, (n,)."""
        self._kalman.missed(unsure * self.torque_constant / self._inertia, self._kept(duty))
        began, bent = self._bristles()
        predicted = self._predicted(duty, gravity)
        return self._corrected(predicted, np.zeros((3, len(duty))), np.zeros(len(duty)), began, bent)

    def step(self, duty: Vector, gravity: Vector, reported: Vector) -> Estimate:
        """A period in which a fraction of full PWM acted, (n,), ended with a report, (n,), rad; NaN for joints whose
        report was lost."""
        began, bent = self._bristles()
        predicted = self._predicted(duty, gravity)
        heard = np.isfinite(reported)
        return self._corrected(
            predicted, self._kalman.gains(heard), np.where(heard, reported - predicted, 0.0), began, bent
        )

    def _kept(self, duty: Vector) -> Vector:
        """What a period leaves of an error in speed now, (n,): friction that falls as a joint goes faster, from F_s to
        F_c by exp(−(v / v_s)²), makes it grow."""
        drive, falls = self._drive, np.zeros(len(duty))
        if self._player.bristly:
            dry = drive.frictionloss + drive.load_friction * drive.torque_constant * np.abs(duty)
            along = np.abs(self._data.qvel[self._player.dofs]) / drive.stribeck_speed
            steep = 2.0 * along * np.exp(-np.square(along))
            falls = steep * dry * (drive.stiction - 1.0) / drive.stribeck_speed
        return np.asarray(np.exp((falls - drive.damping) * self.period / self._inertia))

    def _bristles(self) -> tuple[Vector, Vector]:
        """Where joints are, and how far their bristles are bent, (n,), rad."""
        return self._data.qpos[self._player.qpos].copy(), self._data.act[self._player.bristles].copy()

    def _corrected(self, predicted: Vector, gains: Array, error: Vector, began: Vector, bent: Vector) -> Estimate:
        """Estimate of a period that began at some positions and bristles, by gains, (3, n), times errors, (n,), rad."""
        data, player = self._data, self._player
        went = data.qpos[player.qpos] - began
        data.qpos[player.qpos] += gains[0] * error
        data.qvel[player.dofs] += gains[1] * error
        speed = data.qvel[player.dofs].copy()
        rests = np.exp(-np.square(speed / REST))
        if not player.bristly:
            data.qpos[player.qpos] += self.period * self._creep(rests)
        if player.bristly:
            sprung = np.clip(bent + went, -self._drive.bristle, self._drive.bristle)
            data.act[player.bristles] += rests * (sprung - data.act[player.bristles])
        stopped = push_into_stop(data.qpos[player.qpos], error, self._lower, self._upper)
        pushed = (1.0 - self.period / FORGET * rests) * data.qfrc_applied[player.dofs]
        pushed += np.where(stopped, 0.0, gains[2] * error)
        data.qfrc_applied[player.dofs] = pushed
        return Estimate(predicted, data.qpos[player.qpos].copy(), pushed, speed, self._side(speed))

    def _creep(self, rests: Vector) -> Vector:
        """Speed at which the hand's joints creep under their load in friction, (n,), rad/s: as much of a disturbance
        as that explains, and none that points against the load. `rests`: how much each of them rests, 0 to 1."""
        data, dofs = self._data, self._player.dofs
        pushed = data.qfrc_applied[dofs]
        load = data.qfrc_smooth[dofs] - pushed
        side = np.sign(load)
        most = np.minimum(side * load, self._model.dof_frictionloss[dofs]) * self._softness
        along, crept = side * pushed, np.maximum(side * self._crept, 0.0)
        crept = rests * np.minimum(np.maximum(crept + CREEPS[1] * self.period * along, 0.0), most)
        self._crept = side * crept
        return np.asarray(side * rests * np.minimum(np.maximum(crept + CREEPS[0] * along, 0.0), most))

    def alone(self, duty: Vector, gravity: Vector) -> Estimate:
        """A period that no report ends: the disturbance goes on as it is."""
        data, player = self._data, self._player
        predicted = self._predicted(duty, gravity)
        where, speed = (each.copy() for each in (data.qpos[player.qpos], data.qvel[player.dofs]))
        return Estimate(predicted, where, data.qfrc_applied[player.dofs].copy(), speed, self._side(speed))

    def forget(self) -> None:
        """Nothing pushes the joints any more."""
        self._data.qfrc_applied[self._player.dofs] = 0.0

    def become(self, change: JointChange) -> None:
        """Go on as another hand; its gains stay those of the one that it was."""
        drive, n = self._file, len(self._file.damping)
        losses = {name: value for name in ("damping", "frictionloss") if (value := getattr(change, name)) is not None}
        constant = drive.torque_constant * change.strength
        rows = {name: np.full(n, value) for name, value in losses.items()}
        self._file = replace(drive, torque_constant=constant, **rows)
        self.compensate(self._change)

    def compensate(self, change: ModelChange) -> None:
        """Go on as a hand that differs by this from its file; its gains stay those of the file."""
        file, before = self._file, self._drive.offset
        self._change = change
        self._drive = replace(
            file,
            torque_constant=file.torque_constant * change.strength,
            frictionloss=file.frictionloss + change.friction,
            offset=file.offset + change.offset,
        )
        self._player.prepared(self._drive)
        if change.payload.any():
            self._model.body_mass[self._links] += change.payload
            mujoco.mj_setConst(self._model, mujoco.MjData(self._model))
        self.torque_constant, self._offset = self._drive.torque_constant, self._drive.offset
        self._data.qpos[self._player.qpos] -= self._offset - before

    def _predicted(self, duty: Vector, gravity: Vector) -> Vector:
        """What will be reported after one more period, (n,), rad."""
        data, player = self._data, self._player
        self._sent.append(duty)
        tilt = self._drive.tilt
        self._model.opt.gravity[:] = rotate_vector(gravity, tilt[0]) if len(tilt) else gravity
        controls = np.einsum("skn,kn->sn", self._weights, np.array(self._sent))
        player.rub(self._drive, controls.mean(axis=0), self._time)
        self._time += self.period
        for control in controls:
            data.ctrl[player.motors] = control
            player.stray(self._drive, data)
            mujoco.mj_step(self._model, data)
        return np.asarray(data.qpos[player.qpos] + self._offset)

    def _side(self, velocity: Vector) -> Vector:
        """Dry friction at these speeds, (n,), rad/s, over that in fast motion, (n,): bristles that bend far tell it
        where a speed does not."""
        if not self._player.bristly:
            return np.tanh(velocity / CREEP)
        return np.asarray(self._drive.stiction / self._drive.bristle * self._data.act[self._player.bristles])

    def pull(self) -> Array:
        """What a kilogram at each link's centre of mass would weigh on each joint now, (links, n), N·m; links by the
        joint that moves them."""
        model, data, down = self._model, self._data, self._model.opt.gravity
        jacobian, found = np.empty((3, model.nv)), np.empty((len(self._links), len(self._links)))
        for row, body in enumerate(self._links):
            mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
            found[row] = (down @ jacobian)[self._player.dofs]
        return found

    def lean(self) -> Array:
        """How the torques of gravity turn with the joints now, ∂τ/∂q, (n, n), N·m/rad: a link's weight m at c turns
        with joints a, b before it, a nearer to the palm, by m g · (e_a × (e_b × (c − p_b))), e: axes, p: places."""
        model, data, joints = self._model, self._data, self._joints
        axes, bodies = data.xaxis[joints], model.jnt_bodyid[joints]
        turned = np.cross(axes, data.subtree_com[bodies] - data.xanchor[joints])
        half = np.cross(model.opt.gravity, axes) @ (model.body_subtreemass[bodies, None] * turned).T * self._before
        return np.asarray(half + half.T - np.diag(half.diagonal()))

    def _filter(self, spec: HandSpec, drive: DriveParameters, period: float) -> tuple[JointKalman, Vector]:
        """And inertia seen at the joints, (n,), kg·m²."""
        data = mujoco.MjData(self._model)
        data.qpos[self._player.qpos] = (spec.lower + spec.upper) / 2.0
        mujoco.mj_forward(self._model, data)
        whole = np.zeros((self._model.nv, self._model.nv))
        mujoco.mj_fullM(self._model, data, whole)
        inertia = np.diag(whole)[self._player.dofs]
        return joint_filter(inertia, drive.damping, period, self.noise), inertia


def push_into_stop(position: Vector, error: Vector, lower: Vector, upper: Vector) -> NDArray[np.bool_]:
    """Which joints are at a stop, and reported to be further in it, (n,). What pushes there is the stop's to carry: a
    disturbance would wind up for as long as it lasts, to many times what any motor has."""
    return np.asarray(((position >= upper) & (error > 0.0)) | ((position <= lower) & (error < 0.0)))


def joint_filter(inertia: Vector, damping: Vector, period: float, noise: Vector) -> JointKalman:
    """Kalman filter of joints from inertia, kg·m², damping, N·m·s/rad, period, s, and noise, rad; (n,) each."""
    n = len(inertia)
    A, Q = np.zeros((n, 3, 3)), np.zeros((n, 3, 3))
    A[:, [0, 1, 2], [0, 1, 2]] = np.stack([np.ones(n), np.exp(-damping * period / inertia), np.ones(n)], axis=1)
    A[:, 0, 1], A[:, 1, 2] = period, period / inertia
    Q[:, 0, 0], Q[:, 1, 1], Q[:, 2, 2] = 1e-14, np.square(period / inertia * TORQUE), WALK**2
    return JointKalman(A, Q, noise, period)
