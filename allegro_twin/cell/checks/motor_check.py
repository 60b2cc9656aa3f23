"""Motor power check: which joints are away from their goal without the torque that should bring them there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from allegro_twin.cell.states import CellOutcome
from allegro_twin.control.trajectory import SetPoint
from allegro_twin.safety import Limits, clamp
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, HandState, Vector

_SHARE = 0.5
"""Least share of the torque due that a working motor gives. Motors of one model differ by 0.85 to 1.15."""
_LEAST = 0.1
"""Share of a motor's limit below which a torque due is not checked; nor is one below four times the dry friction."""
_SLOW = 0.1
"""rad/s. A joint that moves is braked by its loop, and is not judged."""
_FOLLOWED = 0.5
"""Share of the goal's speed, from a fifth of `_SLOW` on, that shows that a joint has a motor."""
_FOR = 0.15
"""s that a joint lacks torque without a pause before it is a fault."""
_MOVED = 2e-4
"""rad: two counts of an Allegro Hand's encoder, 333.3°/65536. A reading that changes by less has not moved."""
_FAR = 0.1
"""rad that a goal has gone before a reading that has not moved is a fault."""


class MotorCheck:
    """Watches a hand, state by state. `stiffness`, (n,), N·m/rad, is that of its position loop, in the controller or
    in the firmware; `forces`, (2, n), N·m, what its motors give at the least and at the most."""

    def __init__(self, spec: HandSpec, stiffness: Vector, forces: Array, period: float) -> None:
        motor = spec.actuation
        self._spec, self._stiffness, self._forces = spec, stiffness, forces
        self._limits = Limits(motor.torque_limit, np.full(spec.n_joints, np.inf), spec.lower, spec.upper)
        self._least = np.maximum(_LEAST * motor.torque_limit, 4.0 * motor.frictionloss)
        self._since = np.zeros(spec.n_joints, dtype=np.int64)
        self._most = round(_FOR / period)
        self._first: tuple[Vector, Vector] | None = None

    def begin(self, state: HandState, goal: Vector) -> None:
        """The fingers set out from here for a goal, (n,), rad."""
        self._first = state.position, goal - state.position

    def update(self, state: HandState, target: SetPoint, gravity: Vector) -> None:
        """One more state, where the fingers should be, and what carries them, (n,), N·m."""
        self._since = np.where(self.lacking(state, target, gravity), self._since + 1, 0)

    def lacking(self, state: HandState, target: SetPoint, gravity: Vector) -> NDArray[np.bool_]:
        """Which joints, (n,), rest away from their goal with less than half of the torque k (q_goal - q) + τ_gravity,
        within the motor's limit, that they should have. What follows a slow goal is braked by its loop as it should be;
        what a hand does not report lacks nothing."""
        still = np.maximum(np.abs(state.velocity), np.abs(target.velocity)) < _SLOW
        due = self._due(state, target, gravity)
        goal = target.velocity
        follows = (np.abs(goal) > 0.2 * _SLOW) & (state.velocity * np.sign(goal) > _FOLLOWED * np.abs(goal))
        asked = np.minimum(np.abs(due), np.abs(self._pull(state, target))) > self._least
        with np.errstate(invalid="ignore"):
            return np.asarray(asked & still & ~follows & (state.torque * np.sign(due) < _SHARE * np.abs(due)))

    def given(self, state: HandState, target: SetPoint, gravity: Vector) -> Vector:
        """The motors' torques, (n,), N·m: as reported, or as they are due of a hand that does not report them."""
        return np.asarray(np.where(np.isnan(state.torque), self._due(state, target, gravity), state.torque))

    def _pull(self, state: HandState, target: SetPoint) -> Vector:
        return np.asarray(self._stiffness * (target.position - state.position))

    def _due(self, state: HandState, target: SetPoint, gravity: Vector) -> Vector:
        """Within the motors' limits, and fading before a soft stop where the guard sees to that."""
        pull, (least, most) = self._pull(state, target), self._forces
        if "torque" in self._spec.commands:
            return clamp(pull + gravity, state, self._limits)
        return np.asarray(np.minimum(np.maximum(pull, least), most))

    def fault(self, state: HandState, target: SetPoint) -> CellOutcome | None:
        """What is wrong with a motor, by the joint's name; None while nothing is."""
        weak = np.flatnonzero(self._since >= self._most)
        if not len(weak):
            return None
        off, limit = np.abs(target.position - state.position), self._limits.torque
        worst = int(weak[np.argmax((self._stiffness * off)[weak])])
        names = ", ".join(self._spec.joint_labels[joint] for joint in weak)
        said = (
            f"{names} without torque: {self._spec.joint_labels[worst]} is {off[worst]:.3f} rad from its goal and gives "
            f"{abs(state.torque[worst]):.2f} N·m of {limit[worst]:.2f}; see to the motors' power and to their driver"
        )
        return CellOutcome("fault", "hand without torque", said)

    def dead(self, state: HandState) -> CellOutcome | None:
        """An encoder whose reading has not changed since `begin` while its goal went far; None where all have."""
        if self._first is None:
            return None
        begin, way = self._first
        still = (np.abs(state.position - begin) < _MOVED) & (np.abs(way) > _FAR)
        if not still.any():
            return None
        joint = int(np.argmax(np.where(still, np.abs(way), 0.0)))
        said = (
            f"{self._spec.joint_labels[joint]} still reads {state.position[joint]:.4f} rad after its goal went "
            f"{abs(way[joint]):.2f} rad: its encoder is dead or the joint is stuck; see to it"
        )
        return CellOutcome("fault", "hand stuck", said)
