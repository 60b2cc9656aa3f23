"""Transmission: the travel of each motor, as rotation of its joint or as drawn-in tendon."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array


class ActuatorLengths:
    """Positions and speeds of the actuators of one layout of models: lengths in MuJoCo's words, rad or m.

    On joints and on tendons that run over joints they are sums of joint positions, written out here so that asking
    leaves a simulation as it is, and a row is the same whatever the size of its batch.
    """

    def __init__(self, spec: HandSpec, model: mujoco.MjModel) -> None:
        self._ids = np.array([model.actuator(name).id for name in spec.joints])
        joints = [_over(model, int(number)) for number in self._ids]
        self.sums = all(each is not None for each in joints)
        """Whether they are; else a tendon runs through space."""
        used = sorted({joint for each in joints for joint in (each or {})})
        self._qpos, self._dof = model.jnt_qposadr[used], model.jnt_dofadr[used]
        self._coefficients = np.array([[(each or {}).get(joint, 0.0) for joint in used] for each in joints])

    def position(self, qpos: Array) -> Array:
        """(..., nq) → (..., n), rad or m."""
        return self._summed(qpos, self._qpos)

    def velocity(self, qvel: Array) -> Array:
        """(..., nv) → (..., n), rad/s or m/s."""
        return self._summed(qvel, self._dof)

    def jacobian(self, nv: int) -> Array:
        """Jacobian of the motors' positions by all speeds of a model, (n, nv)."""
        found = np.zeros((len(self._coefficients), nv))
        found[:, self._dof] = self._coefficients
        return found

    def look(self, model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
        """Position and velocity, (n,) each, of tendons that run through space: the kinematics of `data` become those
        of its positions."""
        for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_tendon, mujoco.mj_transmission):
            stage(model, data)
        mujoco.mj_fwdVelocity(model, data)
        return data.actuator_length[self._ids].copy(), data.actuator_velocity[self._ids].copy()

    def _summed(self, values: Array, columns: NDArray[np.int_]) -> Array:
        return sum_each(values[..., None, columns] * self._coefficients)


def sum_each(terms: Array) -> Array:
    """Sums over the last axis, (..., k) → (...): equal terms give equal bits, however many sums there are and however
    they lie in memory. NumPy adds eight or more terms in an order that depends on their layout."""
    found: Array = (np.ascontiguousarray(terms) if isinstance(terms, np.ndarray) else terms).sum(axis=-1)
    return found


def _over(model: mujoco.MjModel, actuator: int) -> dict[int, float] | None:
    """Coefficients of the joints that sum up to an actuator's length, by joint; None where it is no such sum."""
    target, gear = int(model.actuator_trnid[actuator, 0]), float(model.actuator_gear[actuator, 0])
    if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT:
        return {target: gear}
    first, count = int(model.tendon_adr[target]), int(model.tendon_num[target])
    wraps = range(first, first + count)
    if any(model.wrap_type[k] != mujoco.mjtWrap.mjWRAP_JOINT for k in wraps):
        return None
    return {int(model.wrap_objid[k]): gear * float(model.wrap_prm[k]) for k in wraps}
