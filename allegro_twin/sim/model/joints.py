"""Joint addresses: where a posture of the hand is in its simulation's state."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector


class PostureMap:
    """Puts postures into `qpos`: driven joints, and those that follow where they are when nothing is in their way."""

    def __init__(self, spec: HandSpec, model: mujoco.MjModel) -> None:
        self._spec, driven = spec, motor_joints(spec, model)
        self._driven = np.array([*driven], dtype=np.int64)
        self._places = np.array([int(model.jnt_qposadr[joint]) for joint in driven.values()], dtype=np.int64)
        self._followers = [int(model.joint(each.name).qposadr[0]) for each in spec.followers]
        self.joints = [*driven.values(), *(int(model.joint(each.name).id) for each in spec.followers)]
        """All that move, by their number in the model: those that motors turn, then those that follow."""
        self.motors = np.array([*driven, *(each.driven for each in spec.followers)], dtype=np.int64)
        """Motor that moves each of these joints."""

    def __call__(self, posture: Array, qpos: Array) -> None:
        """Write postures, (..., n), rad, into states, (..., nq)."""
        qpos[..., self._places] = posture[..., self._driven]
        if self._followers:
            qpos[..., self._followers] = self._spec.coupled_positions(posture)

    def each(self, motors: Vector, qpos: Array) -> None:
        """Write where `joints` are if each had a motor to itself, at `motors`, (joints,), rad: what has met something
        stays behind its neighbours."""
        direct = len(self._driven)
        qpos[self._places] = motors[:direct]
        if self._followers:
            qpos[self._followers] = self._spec.coupled_each(motors[direct:])


def motor_joints(spec: HandSpec, model: mujoco.MjModel) -> dict[int, int]:
    """The joint that each motor turns, by the motor's place in the spec; motors on tendons have none."""
    found = {}
    for index, name in enumerate(spec.joints):
        motor = model.actuator(name)
        if motor.trntype[0] == mujoco.mjtTrn.mjTRN_JOINT:
            found[index] = int(motor.trnid[0])
    return found


def as_slice(indices: list[int]) -> slice | list[int]:
    """A slice where the indices run on, which NumPy reads faster than a list."""
    indices = [int(index) for index in indices]
    if indices and indices == list(range(indices[0], indices[0] + len(indices))):
        return slice(indices[0], indices[0] + len(indices))
    return indices


class JointChange(NamedTuple):
    """Changed properties of every joint; None: unchanged."""

    damping: float | None = None
    """N·m·s/rad."""
    frictionloss: float | None = None
    """Dry friction, N·m."""
    strength: float = 1.0
    """What its motors give of what they gave."""


def moving_dofs(spec: HandSpec, model: mujoco.MjModel) -> list[int]:
    """Degrees of freedom of a compiled hand's joints: of those that motors turn, then of those that follow."""
    return [int(model.jnt_dofadr[joint]) for joint in PostureMap(spec, model).joints]


def set_joint_losses(spec: HandSpec, model: mujoco.MjModel, change: JointChange) -> None:
    """Set the damping and dry friction of a compiled hand's joints."""
    dofs = moving_dofs(spec, model)
    if change.damping is not None:
        model.dof_damping[dofs] = change.damping
    if change.frictionloss is not None:
        model.dof_frictionloss[dofs] = change.frictionloss
