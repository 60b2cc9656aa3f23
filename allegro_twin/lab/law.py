"""How the arm goes: far ways through its joints, the last stretch and what touches something as on a spring."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from allegro_twin.arm.impedance import Hanging, hung
from allegro_twin.arm.target import Smoothing, Target, approached
from allegro_twin.control.steering import Steering
from allegro_twin.kinematics.arm import ArmModel
from allegro_twin.types import HandState, TorqueCommand, Vector

_QUICK = 30.0
"""rad/s: how fast what is off goes, ω of docs/arm.md's follower."""


class Guide:
    """Where the arm is to be: a posture, by a path of its joints, or a pose of the flange. Moved by the states."""

    def __init__(self, posture: Vector, model: ArmModel) -> None:
        self._model = model
        self.target = Target(model.pose(posture))
        """The pose, in the base's frame; of the path's end while there is one."""
        self.path: Steering | None = Steering(posture)

    def through_joints(self, t: float, position: Vector, posture: Vector, speed: float) -> float:
        """From rest at `position` (n,), rad, to a posture, the fastest joint at `speed`, rad/s. When it is there, s."""
        self.target.move(self._model.pose(posture))
        self.path = Steering(position)
        return self.path.head_for(t, posture, speed)

    def let_go(self) -> None:
        """From now on the target counts, as on a spring."""
        self.path = None


@dataclass(frozen=True, slots=True, eq=False)
class Guided:
    """The controller: τ = M(ω² (q_r - q) + 2ω (q̇_r - q̇)) + C q̇ on a path, impedance off it.

    The spring begins where the path ended, and the elbow likes to stay as it was there.
    """

    model: ArmModel
    guide: Guide
    stiffness: Vector
    """(6,), N/m and N·m/rad."""
    smoothing: Smoothing
    null: float = 10.0
    """N·m/rad, as of `Impedance`."""

    def start(self, state: HandState) -> Hanging:
        return Hanging(self.model.pose(state.position), state.position, state.t)

    def __call__(self, state: HandState, memory: Hanging) -> tuple[TorqueCommand, Hanging]:
        path = self.guide.path
        if path is None:
            setpoint = approached(memory.setpoint, self.guide.target.pose, state.t - memory.t, self.smoothing)
            torque = hung(self.model, state, setpoint, memory.rest, self.stiffness, self.null)
            return TorqueCommand(torque), Hanging(setpoint, memory.rest, state.t)
        point = path(state.t)
        wanted = _QUICK**2 * (point.position - state.position) + 2.0 * _QUICK * (point.velocity - state.velocity)
        torque = self.model.inertia(state.position) @ wanted + self.model.coriolis(state.position, state.velocity)
        return TorqueCommand(np.asarray(torque)), Hanging(self.model.pose(point.position), point.position, state.t)
