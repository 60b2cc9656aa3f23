"""The motors of the hands in a batch: where they are, what they are told, and what reaches them from outside.

A motor may turn one joint, or pull a tendon over several; what it is told is a torque, or, where the hand's firmware
closes the loop, where to be.
"""

from __future__ import annotations

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.sim.drivetrain.transmission import Lengths
from allegro_twin.sim.model.postures import Posed, moved_by, span
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array


class Driven:
    """Of one layout of models. Raises ConfigError for one whose motors a batch cannot read."""

    def __init__(self, spec: HandSpec, model: mujoco.MjModel) -> None:
        self.spec, self._posed = spec, Posed(spec, model)
        motors = span([model.actuator(name).id for name in spec.joints])
        if not isinstance(motors, slice):
            raise ConfigError(f"{spec.name}: the motors of this model do not follow one another, as a batch needs")
        self.motors = motors
        """Their columns in what a model is told."""
        self.leads = "torque" not in spec.commands
        """Whether they are told where to be."""
        self.columns = _columns(spec, model)
        """Of the joints in qpos and in qvel, where each motor turns a joint of its own; else None."""
        self._lengths = Lengths(spec, model)
        if self.columns is None and not self._lengths.sums:
            raise ConfigError(f"{spec.name}: its tendons run through space, and a batch does not know where its motors "
                              "are: simulate it alone, with SimBackend")  # fmt: skip
        self.dofs = np.array(model.jnt_dofadr[self._posed.joints], np.int64)
        """Of all that moves, in qvel."""
        self._coefficients = np.zeros((len(self.dofs), spec.n_joints))
        self._coefficients[np.arange(len(self.dofs)), self._posed.motors] = 1.0
        if self.leads:
            bias, gain = model.actuator_biasprm[motors], model.actuator_gainprm[motors, 0]
            # Force = gain u + b0 + b1 l + b2 dl/dt is zero at rest where u = - (b0 + b1 l) / gain.
            self._offset, self._slope = -bias[:, 0] / gain, -bias[:, 1] / gain

    def position(self, qpos: Array) -> Array:
        """(n, nq) → (n, motors), rad."""
        return self._lengths.position(qpos)

    def velocity(self, qvel: Array) -> Array:
        """(n, nv) → (n, motors), rad/s."""
        return self._lengths.velocity(qvel)

    def told(self, values: Array) -> Array:
        """What the model is to be told for torques, N·m, or positions, rad, (n, motors)."""
        return self._offset + self._slope * values if self.leads else values

    def placed(self, posture: Array, qpos: Array) -> Array:
        """States (n, nq) with the hands in postures (n, motors), rad: what follows is where nothing is in its way."""
        found = np.array(qpos)
        self._posed(posture, found)
        return found

    def reduced(self, forces: Array, position: Array) -> Array:
        """Torques on all joints (n, nv) as the motors would feel them along the hand's free way, (n, motors), N·m: by
        virtual work, with motors at `position` (n, motors), rad."""
        rates = np.concatenate([np.ones((len(position), len(self.dofs) - len(self.spec.followers))),
                                self.spec.coupled_rates(position)], axis=-1)  # fmt: skip
        work = rates * forces[:, self.dofs]
        found: Array = (work[:, None, :] * self._coefficients.T).sum(axis=-1)
        return found


def _columns(spec: HandSpec, model: mujoco.MjModel) -> tuple[slice, slice] | None:
    moved = moved_by(spec, model)
    if spec.followers or len(moved) < spec.n_joints:
        return None
    place, motion = (
        span(list(model.jnt_qposadr[list(moved.values())])),
        span(list(model.jnt_dofadr[list(moved.values())])),
    )
    return (place, motion) if isinstance(place, slice) and isinstance(motion, slice) else None
