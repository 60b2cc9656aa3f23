"""The hand in MuJoCo: lockstep, as fast as it goes, the same bits every time."""

from __future__ import annotations

import hashlib
import math
from typing import NamedTuple

import mujoco
import numpy as np

from allegro_twin.backend import position_of, torque_of
from allegro_twin.drive import Ailment, Drive
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.sim import wrist
from allegro_twin.sim.drivetrain import Drivetrain
from allegro_twin.sim.lengths import Lengths
from allegro_twin.sim.posed import Posed, moved_by
from allegro_twin.sim.servos import ONE, Servos
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Command, HandState, Vector, frozen

ENGINE = f"mujoco {mujoco.__version__}"
"""What the figures of a simulation depend on."""
_NO_WRIST = np.zeros((0, 6))


class Push(NamedTuple):
    """What pushes a body from outside."""

    body: str
    force: Array
    """On its centre of mass in every control period from the reset on, (k, 3), N, world; nothing after the last."""


class SimBackend:
    """A hand in a compiled scene.

    `drive` holds the wrist's set-points for every physics step, shape (k, 6); after the last one the wrist stays.
    `posture` is the joint position at reset, shape (n,), rad; by default the nearest to zero inside the limits. Joints
    that follow begin where they are when nothing is in their way.
    `pushing` is what pushes a body of the scene.
    Raises ConfigError for a period that is not a whole number of the model's timesteps.
    """

    def __init__(
        self,
        spec: HandSpec,
        model: mujoco.MjModel,
        *,
        period: float = 0.003,
        posture: Vector | None = None,
        drive: Array = _NO_WRIST,
        pushing: Push | None = None,
    ) -> None:
        self._substeps = substeps(period, model.opt.timestep)
        self._spec, self._period, self.model, self.data = spec, period, model, mujoco.MjData(model)
        self._motors = span([model.actuator(name).id for name in spec.joints])
        self._servos = None if "torque" in spec.commands else Servos(spec, [model], period)
        self._lengths = Lengths(spec, model)
        joints = list(moved_by(spec, model).values())
        self._qpos = span([model.jnt_qposadr[joint] for joint in joints])
        self._dof = span([model.jnt_dofadr[joint] for joint in joints])
        self._pose = Posed(spec, model)
        self._palm = model.body("palm_link").id
        self._posture = np.clip(0.0, spec.lower, spec.upper) if posture is None else spec.posture(posture)
        self.drive, self.pushing = drive, pushing
        self._pushed = None if pushing is None or not pushing.force.any() else model.body(pushing.body).id
        self._wrist = [model.actuator(name).id for name in wrist.JOINTS] if len(drive) else []
        self._unknown = frozen(np.full(spec.n_actuators, math.nan))
        self._train = None if spec.drive is None else Drivetrain(spec, spec.drive, model, self._motors)
        self._tick = 0

    @property
    def spec(self) -> HandSpec:
        return self._spec

    @property
    def period(self) -> float:
        return self._period

    @property
    def posture(self) -> Vector:
        """At reset, (n,), rad."""
        return self._posture

    def reset(self) -> HandState:
        mujoco.mj_resetData(self.model, self.data)
        self._pose(self._posture, self.data.qpos)
        if self._wrist:
            self.data.ctrl[self._wrist] = self.drive[0]
        if self._servos is not None:
            self._servos.limp(ONE)
        mujoco.mj_forward(self.model, self.data)
        if self._servos is not None:
            self._servos.reset(ONE, self._moved()[0][None])
        if self._train is not None:
            self._train.reset()
        self._tick = 0
        return self._state()

    def write(self, command: Command) -> None:
        if self._servos is not None:
            wanted = position_of(command, self._spec)
            self._servos.command(ONE, wanted.position[None], wanted.effort, wanted.duration or 0.0)
            return
        torque = torque_of(command, self._spec)
        if self._train is None:
            self.data.ctrl[self._motors] = torque
        else:
            self._train.command(torque)

    def read(self) -> HandState:
        if self._pushed is not None and self.pushing is not None:
            rows = self.pushing.force[self._tick : self._tick + 1]
            self.data.xfrc_applied[self._pushed, :3] = rows[0] if len(rows) else 0.0
        if self._servos is not None:
            self.data.ctrl[self._motors] = self._servos.told(ONE)[0]
        first = self._tick * self._substeps
        rows = self.drive[first : first + self._substeps]
        if len(rows) or self._train is not None:
            for k in range(self._substeps):
                if k < len(rows):
                    self.data.ctrl[self._wrist] = rows[k]
                if self._train is not None:
                    self._train.step(self.data)
                mujoco.mj_step(self.model, self.data)
        else:
            mujoco.mj_step(self.model, self.data, self._substeps)
        self._tick += 1
        return self._state()

    def push(self, torque: Vector) -> None:
        """Torques on the joints from outside, (n,), N·m, until replaced: a person who leads the fingers."""
        self.data.qfrc_applied[self._dof] = torque

    def suffer(self, what: Ailment, joint: int, amount: float) -> None:
        """Something goes wrong with a joint, for good."""
        if self._train is None:
            self._train = Drivetrain(self._spec, Drive.made({}, self._spec.n_joints), self.model, self._motors)
            self._train.command(self.data.ctrl[self._motors].copy())
        self._train.suffer(what, joint, amount)

    def close(self) -> None:
        if self._servos is not None:
            self._servos.limp(ONE)
        else:
            self.data.ctrl[self._motors] = 0.0

    def mass_of(self, body: str) -> float:
        """Of a body of the scene, kg."""
        return float(self.model.body_mass[self.model.body(body).id])

    def meta(self) -> dict[str, str]:
        """What a recording should say of the simulation: the engine, and a hash of the model as it was stepped."""
        if self._servos is None:
            return {"engine": ENGINE, "model": _hash(self.model)}
        with self._servos.able():
            return {"engine": ENGINE, "model": _hash(self.model)}

    def _moved(self) -> tuple[Array, Array]:
        """Position and velocity of what is driven, (n,) each."""
        data = self.data
        if self._servos is None:
            return data.qpos[self._qpos].copy(), data.qvel[self._dof].copy()
        if self._lengths.sums:
            return self._lengths.position(data.qpos), self._lengths.velocity(data.qvel)
        return self._lengths.look(self.model, data)

    def _state(self) -> HandState:
        data = self.data
        position, velocity = self._moved()
        if not math.isfinite(position.sum()):
            raise HandFault(f"the simulation diverged at {self._tick * self._period:.3f} s: {_unstable(data)}")
        if self._train is not None:
            position = self._train.reported(position, data)
        torque = data.actuator_force[self._motors].copy()
        gravity = self.model.opt.gravity @ data.xmat[self._palm].reshape(3, 3)
        for array in (position, velocity, torque, gravity):
            array.setflags(write=False)
        t = self._tick * self._period
        return HandState(t, self._tick, position, velocity, torque, self._unknown, gravity)


def substeps(period: float, timestep: float) -> int:
    """Physics steps in a control period. Raises ConfigError unless it is a whole number of them."""
    count = round(period / timestep) if math.isfinite(period) else 0
    if count < 1 or abs(count * timestep - period) > 1e-9:
        raise ConfigError(f"period {period} s is not a whole number of physics steps of {timestep} s")
    return count


def span(indices: list[int]) -> slice | list[int]:
    """A slice where the indices run on, which NumPy reads faster than a list."""
    indices = [int(index) for index in indices]
    if indices and indices == list(range(indices[0], indices[0] + len(indices))):
        return slice(indices[0], indices[0] + len(indices))
    return indices


def _hash(model: mujoco.MjModel) -> str:
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return hashlib.sha256(buffer.tobytes()).hexdigest()[:16]


def _unstable(data: mujoco.MjData) -> str:
    found = [mujoco.mjtWarning(i).name for i in range(len(data.warning)) if data.warning[i].number]
    return ", ".join(found) or "no warning from the engine"
