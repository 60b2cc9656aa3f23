"""The observer of a hand that closes its own loop: the same loop in a simulation, told the same, corrected by reports.

For every motor a steady Kalman filter with the states position l, speed and disturbance:

    M l̈ = K (u − l) − B l̇ + d,    d ← d + random walk;    reported: l + noise

M: inertia seen at the motor, K and B: its loop. What is driven is compared: l = C q where a tendon runs over joints q.
A correction of l moves these along the hand's free way, ∂q/∂l of its card, scaled to C ∂q/∂l = 1; with a motor on each
joint that is 1. Joints that follow are not reported, and stay where the simulation has them.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.sim.drivetrain.servos import ONE, Servos
from allegro_twin.sim.drivetrain.transmission import ActuatorLengths
from allegro_twin.sim.model.joints import JointChange, PostureMap, motor_joints, set_joint_losses
from allegro_twin.sim.model.physics import Physics
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.sim.observer.kalman import JointKalman
from allegro_twin.sim.observer.observer import CREEP, Estimate, push_into_stop
from allegro_twin.spec import HandSpec
from allegro_twin.spec.coupled_joints import CoupledJoint
from allegro_twin.types import Array, PositionCommand, Vector

try:
    from scipy.linalg import expm  # type: ignore[import-untyped]  # Its types are a package of its own.
except ImportError as error:
    raise ConfigError("a twin needs SciPy: pip install 'allegro-twin[twin]'") from error

STEP = 0.001  # s, at most, of the simulation.
NOISE = 4.4e-4  # rad, of a reported position: a count of 4096 a turn, evenly spread.
LEAST = 0.1  # Of a motor's way that shows in its joints: where less does, only its disturbance is corrected.
TORQUE, WALK = 0.005, 0.05  # Of what a motor gives: errors of the model, and how far a disturbance goes in 1 s^(1/2).


class LoopObserver:
    """A corrected simulation of the hand's own loop. Equal inputs give equal outputs, to the last bit."""

    def __init__(self, spec: HandSpec, period: float) -> None:
        """Raises ConfigError for a hand of which nobody can say where its joints are."""
        self._spec = spec
        self._steps = int(np.ceil(period / STEP - 1e-9))
        stage = Stage(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), physics=Physics(timestep=period / self._steps))
        self._model = model = compile_scene(spec, stage)
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self._data = mujoco.MjData(model)
        self._lengths, self._posed = ActuatorLengths(spec, model), PostureMap(spec, model)
        if not self._lengths.sums:
            raise ConfigError(f"{spec.name} cannot be mirrored: a tendon through space says not where its joints are")
        self._servos = Servos(spec, [model], period)
        self._motors = [model.actuator(name).id for name in spec.joints]
        self._pull = self._lengths.jacobian(model.nv)
        self._bodies = _last_bodies(model, self._pull)
        self._ways = [_Way(spec, model, each) for each in spec.followers]
        self._direct = np.zeros((model.nv, spec.n_joints))
        for motor, joint in motor_joints(spec, model).items():
            self._direct[model.jnt_dofadr[joint], motor] = 1.0
        # A motor at the end of its force answers nothing: its joints are then free but for their springs.
        self.noise = np.full(spec.n_joints, NOISE)
        self._firm, self._slack = (self._filter(spec, period, answers) for answers in (1.0, 0.0))
        self.period, self.held = period, np.zeros(spec.n_joints)

    @property
    def torque(self) -> Vector:
        """What the motors gave in the simulation's last step, (n,), N·m."""
        return np.array(self._data.actuator_force[self._motors])

    def reset(self, position: Vector, time: float = 0.0) -> None:
        """Begin where the hand reports to be, (n,), rad, at rest and limp; what it is like does not change with the
        `time`, s."""
        mujoco.mj_resetData(self._model, self._data)
        self._posed(position, self._data.qpos)
        self._servos.limp(ONE)
        self._servos.reset(ONE, position[None])
        self._disturbance = np.zeros(len(position))

    @property
    def spread(self) -> Vector:
        """Standard deviation of the disturbance that noise alone makes now, (n,), N·m."""
        return np.where(self._at_end(), self._slack.spread, self._firm.spread)

    @property
    def expected(self) -> Vector:
        """Standard deviation of the last reports from what was predicted, (n,), rad."""
        return np.maximum(self._slack.expected, self._firm.expected)

    def noisier(self, noise: Vector) -> None:
        """From now on reports have this noise, (n,), rad."""
        self.noise = noise
        for each in (self._firm, self._slack):
            each.noisier(noise)

    def missed(self, command: PositionCommand, gravity: Vector) -> Estimate:
        """A period whose report was lost, in which a command held."""
        for each in (self._firm, self._slack):
            each.missed(np.zeros(self._spec.n_joints))
        return self.alone(command, gravity)

    def step(self, command: PositionCommand, gravity: Vector, reported: Vector) -> Estimate:
        """A period in which a command held, ended with a report, (n,), rad; NaN for joints whose report was lost."""
        data = self._data
        predicted, heard = self._predicted(command, gravity), np.isfinite(reported)
        error, spread = np.where(heard, reported - predicted, 0.0), self._spread(predicted)
        gain = np.where(self._at_end(), self._slack.gains(heard), self._firm.gains(heard))
        data.qpos += spread @ (gain[0] * error)
        data.qvel += spread @ (gain[1] * error)
        stopped = push_into_stop(predicted, error, self._spec.lower, self._spec.upper)
        self._disturbance = self._disturbance + np.where(stopped, 0.0, gain[2] * error)
        data.qfrc_applied[:] = self._disturbance @ self._pull
        return self._estimate(predicted)

    def _at_end(self) -> NDArray[np.bool_]:
        """Which motors give all that they can, (n,)."""
        low, high = self._model.actuator_forcerange[self._motors].T
        return np.asarray((self.torque <= low) | (self.torque >= high))

    def alone(self, command: PositionCommand, gravity: Vector) -> Estimate:
        """A period that no report ends: the disturbance goes on as it is."""
        return self._estimate(self._predicted(command, gravity))

    def forget(self) -> None:
        """Nothing pushes what is driven any more."""
        self._disturbance = np.zeros_like(self._disturbance)
        self._data.qfrc_applied[:] = 0.0

    def become(self, change: JointChange) -> None:
        """Go on as another hand, with the strength that it has; its gains stay those of the one that it was."""
        set_joint_losses(self._spec, self._model, change)

    def _predicted(self, command: PositionCommand, gravity: Vector) -> Vector:
        """What will be reported after one more period, (n,), rad."""
        model, data = self._model, self._data
        model.opt.gravity[:] = gravity
        self._servos.command(ONE, command.position[None], command.effort, command.duration or 0.0)
        data.ctrl[self._motors] = self._servos.commands(ONE)[0]
        mujoco.mj_step(model, data, self._steps)
        return self._lengths.position(data.qpos)

    def _estimate(self, predicted: Vector) -> Estimate:
        data = self._data
        where, speed = self._lengths.position(data.qpos), self._lengths.velocity(data.qvel)
        return Estimate(predicted, where, self._disturbance.copy(), speed, np.tanh(speed / CREEP))

    def pull(self) -> Array:
        """What a kilogram at the centre of mass of the last link that each motor moves would weigh on each of them,
        (n, n), N·m."""
        model, data, down = self._model, self._data, self._model.opt.gravity
        spread = self._spread(self._lengths.position(data.qpos))
        jacobian, found = np.empty((3, model.nv)), np.empty((len(self._bodies), len(self._bodies)))
        for row, body in enumerate(self._bodies):
            mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
            found[row] = (down @ jacobian) @ spread
        return found

    def _spread(self, position: Vector) -> Array:
        """∂q/∂l where the motors are at a position, (nv, n)."""
        found = self._direct.copy()
        for way in self._ways:
            found[way.dof, way.motor] = way.slope(position)
        length = np.einsum("nv,vn->n", self._pull, found)
        return found / np.where(length > LEAST, length, np.inf)

    def _filter(self, spec: HandSpec, period: float, answers: float) -> JointKalman:
        """`answers`: 1, or 0 for motors that do not."""
        model, data, middle = self._model, mujoco.MjData(self._model), (spec.lower + spec.upper) / 2.0
        self._posed(middle, data.qpos)
        mujoco.mj_forward(model, data)
        whole = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, whole)
        spread, bias = self._spread(middle), model.actuator_biasprm[self._motors]
        inertia = np.einsum("vn,vw,wn->n", spread, whole, spread)
        springs = model.jnt_stiffness[model.dof_jntid]
        stiffness, damping = (
            own @ np.square(spread) - answers * column
            for own, column in ((springs, bias[:, 1]), (model.dof_damping, bias[:, 2]))
        )
        rows = zip(inertia, stiffness, damping, spec.actuation.torque_limit, strict=True)
        A, Q = (np.array(each) for each in zip(*(motor_dynamics(*row, period) for row in rows), strict=True))
        return JointKalman(A, Q, self.noise, period)


class _Way:
    """Dependence of a coupled joint on its motor."""

    def __init__(self, spec: HandSpec, model: mujoco.MjModel, each: CoupledJoint) -> None:
        self.dof, self.motor = int(model.joint(each.name).dofadr[0]), each.driven
        span, self._count = spec.upper[each.driven] - spec.lower[each.driven], len(each.positions) - 1
        self._lower, self._scale = spec.lower[each.driven], self._count / span
        self._slopes = np.diff(each.positions) * self._scale

    def slope(self, position: Vector) -> float:
        """rad per rad of the motor."""
        part = int((position[self.motor] - self._lower) * self._scale)
        return float(self._slopes[min(max(part, 0), self._count - 1)])


def motor_dynamics(
    inertia: float, stiffness: float, damping: float, limit: float, period: float
) -> tuple[Array, Array]:
    """Transition and process noise of one motor's states over a period, (3, 3) each."""
    flow = np.array([[0.0, 1.0, 0.0], [-stiffness / inertia, -damping / inertia, 1.0 / inertia], [0.0, 0.0, 0.0]])
    A = np.asarray(expm(flow * period))
    push = A[:, 2] * TORQUE * limit
    push[2] = 0.0
    return A, np.outer(push, push) + np.diag([1e-14, 0.0, (WALK * limit) ** 2 * period])


def _last_bodies(model: mujoco.MjModel, pull: Array) -> list[int]:
    """For each motor the outermost link that it moves."""
    return [int(model.dof_bodyid[np.flatnonzero(row).max()]) for row in pull]
