"""The motors of the hands in a batch: where they are, what they are told, and what reaches them from outside.

A motor may turn one joint, or pull a tendon over several; what it is told is a torque, or, where the hand's firmware
closes the loop, where to be.
"""

from __future__ import annotations

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.sim.drivetrain.servos import control_map
from allegro_twin.sim.drivetrain.transmission import ActuatorLengths, sum_each
from allegro_twin.sim.model.joints import PostureMap, as_slice, motor_joints
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array


class BatchMotors:
    """Motors of one layout of models. `alone`: they share one model, and have to be read from its states alone; raises
    ConfigError where that is not possible."""

    def __init__(self, spec: HandSpec, model: mujoco.MjModel, *, alone: bool) -> None:
        self.spec, self._posed = spec, PostureMap(spec, model)
        self.ids = as_slice([model.actuator(name).id for name in spec.joints])
        """Their columns in what a model is told."""
        if alone and not isinstance(self.ids, slice):
            raise ConfigError(f"{spec.name}: the motors of this model do not follow one another, as a batch needs")
        self.closes_loop = "torque" not in spec.commands
        """Whether they are told where to be."""
        self.lengths = ActuatorLengths(spec, model)
        moved = list(motor_joints(spec, model).values())
        direct = not spec.followers and len(moved) == spec.n_joints
        self._columns = (
            (as_slice(list(model.jnt_qposadr[moved])), as_slice(list(model.jnt_dofadr[moved]))) if direct else None
        )
        if alone and self._columns is None and not self.lengths.sums:
            raise ConfigError(f"{spec.name}: its tendons run through space, and a batch does not know where its motors "
                              "are: simulate it alone, with SimBackend")  # fmt: skip
        self.dofs = np.array(model.jnt_dofadr[self._posed.joints], np.int64)
        """Degrees of freedom of all that moves, in qvel."""
        self._coefficients = np.zeros((len(self.dofs), spec.n_joints))
        self._coefficients[np.arange(len(self.dofs)), self._posed.motors] = 1.0
        if self.closes_loop:
            self._offset, self._slope = control_map(model, self.ids)

    @property
    def slices(self) -> tuple[slice, slice] | None:
        """Columns of qpos and of qvel, where each motor turns a joint of its own and these follow one another."""
        match self._columns:
            case (slice() as place, slice() as motion):
                return place, motion
        return None

    @property
    def readable(self) -> bool:
        """Whether states say where the motors are; else the kinematics of tendons through space do."""
        return self.lengths.sums or (self._columns is not None and not self.closes_loop)

    def position(self, qpos: Array) -> Array:
        """(n, nq) → (n, motors), rad."""
        return self.lengths.position(qpos) if self._columns is None or self.closes_loop else qpos[:, self._columns[0]]

    def velocity(self, qvel: Array) -> Array:
        """(n, nv) → (n, motors), rad/s."""
        return self.lengths.velocity(qvel) if self._columns is None or self.closes_loop else qvel[:, self._columns[1]]

    def control(self, values: Array) -> Array:
        """What the model is to be told for torques, N·m, or positions, rad, (n, motors)."""
        return self._offset + self._slope * values if self.closes_loop else values

    def placed(self, posture: Array, qpos: Array) -> Array:
        """States (n, nq) with the hands in postures (n, motors), rad: what follows is where nothing is in its way."""
        found = np.array(qpos)
        self._posed(posture, found)
        return found

    def reduce(self, forces: Array, position: Array) -> Array:
        """Torques on all joints (n, nv) as the motors would feel them along the hand's free way, (n, motors), N·m: by
        virtual work, with motors at `position` (n, motors), rad."""
        rates = np.concatenate([np.ones((len(position), len(self.dofs) - len(self.spec.followers))),
                                self.spec.coupled_rates(position)], axis=-1)  # fmt: skip
        work = rates * forces[:, self.dofs]
        return sum_each(work[:, None, :] * self._coefficients.T)
