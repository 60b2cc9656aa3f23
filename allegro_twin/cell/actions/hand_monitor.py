"""The hand as it was heard last: its motors, and the torque with which its fingers press on something."""

from __future__ import annotations

import numpy as np

from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.checks.grasp_check import NOTHING, presses_surely, pressing_torque, torque_between_fingers
from allegro_twin.cell.checks.motor_check import MotorCheck
from allegro_twin.cell.motion.empty_grasp import EmptyGrasp, empty_grasp, misread_positions, touching_joints
from allegro_twin.cell.states import CellOutcome
from allegro_twin.control.setpoint_filter import SmoothSetpoint
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.types import Array, HandState, Vector


class HandMonitor:
    """Hears every state of the hand. `fingers`: its set-points, rad."""

    def __init__(self, cell: Cell, fingers: SmoothSetpoint) -> None:
        self._cell, self._fingers = cell, fingers
        self._motors = MotorCheck(cell.hand.spec, cell.stiffness, cell.forces, cell.hand.period)
        self.state: HandState | None = None
        """The last one; None before the first."""

    def update(self, state: HandState) -> None:
        """A state of the hand."""
        self.state = state
        self._motors.update(state, self._fingers(state.t), self._gravity(state))

    def begin_closing(self, squeeze: Vector) -> None:
        """The fingers close, and then squeeze with these set-points, (n,), rad."""
        if self.state is not None:
            self._motors.begin(self.state, squeeze)

    def fault(self) -> CellOutcome | None:
        """Why the motors do not move the hand; None where they do."""
        return None if self.state is None else self._motors.fault(self.state, self._fingers(self.state.t))

    def dead(self, hand: HandState) -> CellOutcome | None:
        """The fault of motors without power, after a squeeze; None where they have it."""
        return self._motors.dead(hand)

    def torques(self, hand: HandState) -> tuple[Vector, Vector]:
        """Torques of the motors, and those that carry the fingers' weight, (n,) each, N·m."""
        gravity = self._gravity(hand)
        return self._motors.given(hand, self._fingers(hand.t), gravity), gravity

    def squeeze(self, hand: HandState, empty: EmptyGrasp) -> float:
        """Torque with which the fingers press on each other's object, beyond what they do where there is none, N·m."""
        touching = touching_joints(self._cell.settings.hand, hand.position)
        return torque_between_fingers(self._pressing(hand, hand.position, empty), empty, touching)

    def surely_presses(self, hand: HandState, empty: EmptyGrasp) -> bool:
        """Whether fingers press on something for every way in which their encoders may be misread."""
        cell, ways = self._cell, misread_positions(hand.position)
        meet, fingers = touching_joints(cell.settings.hand, ways), [each.joints for each in cell.hand.spec.fingers]
        return presses_surely(self._pressing(hand, ways, empty), empty, meet, fingers, cell.settings.validation.torque)

    def holds_something(self, grasp: Grasp, state: HandState) -> bool:
        """Whether the fingers press on something. `grasp`: what they were closed with; `state`: the arm's."""
        if self.state is None:
            return True
        empty = empty_grasp(self._cell.settings.hand, grasp, self._cell.robot.palm(state).rotation)
        return self.squeeze(self.state, empty) > NOTHING * self._cell.settings.validation.torque

    def _pressing(self, hand: HandState, position: Array, empty: EmptyGrasp) -> Array:
        torque, gravity = self.torques(hand)
        friction = self._cell.hand.spec.actuation.frictionloss
        return np.asarray(pressing_torque(position, torque - gravity, empty, self._cell.stiffness, friction))

    def _gravity(self, state: HandState) -> Vector:
        return self._cell.model.gravity_torque(state.position, state.gravity)
