"""Motion of a cell's arm and fingers: set-points, a list of goals still ahead, and whether the arm has arrived."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.motion.arm_motion import ArmGuide
from allegro_twin.cell.planning.reachability import far_path
from allegro_twin.control.setpoint_filter import SmoothSetpoint
from allegro_twin.kinematics.arm import rotation_between
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import HandState, Vector

ArmGoal: TypeAlias = "Vector | Pose"
"""A posture of the arm, rad, which is reached through its joints, or a pose of the palm in the world, on a straight
line."""
STILL = 0.02
"""rad/s: the fastest joint of an arm at rest."""
LOOSE = 3.0
"""Factor on the tolerance of an arm that carries something: the load pulls its spring down."""
_SLOWLY = 0.15  # m/s, on average, on a straight line.


class CellMotion:
    """Moves the set-points of arm and fingers; states are the arm's."""

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        self.guide = ArmGuide(cell.posture, cell.robot.model)
        """Set-points of the arm."""
        self.fingers = SmoothSetpoint(cell.open)
        """Set-points of the fingers, rad. Their clock is the run's."""
        self.ahead: list[ArmGoal] = []
        """Goals of the arm that follow the present one."""
        self._end = 0.0
        self._touchdown = self.guide.target.pose

    def is_over(self, t: float, wait: float = 0.0) -> bool:
        """Whether the set-points of arm and fingers have been at their ends for `wait` s."""
        return t >= self._end + wait

    def move_fingers(self, t: float, posture: Vector, speed: float) -> None:
        """Move the fingers to a posture, rad, at up to `speed` rad/s."""
        self._end = self.fingers.head_for(t, posture, speed)

    def follow(self, t: float, state: HandState, *goals: ArmGoal) -> None:
        """Move the arm to the first of these goals; the others are ahead."""
        self.ahead = list(goals)
        self.next(t, state)

    def next(self, t: float, state: HandState) -> None:
        """Move the arm to the next goal ahead."""
        goal = self.ahead.pop(0)
        if isinstance(goal, Pose):
            self.straight(t, goal, self._cell.settings.arm.approach)
        else:
            self._through_joints(t, state, goal)

    def straight(self, t: float, palm: Pose, seconds: float) -> None:
        """Move the palm on a straight line to a pose in the world, in at least `seconds`, at 0.15 m/s at most."""
        flange = self._cell.robot.flange_for(palm)
        way = float(np.linalg.norm(flange.position - self.guide.target.pose.position))
        self._end = max(self._end, self.guide.straight(t, flange, max(seconds, way / _SLOWLY)))

    def return_to_wait(self, t: float, state: HandState) -> str | None:
        """Move the arm to the posture in which it waits. Where something is in the way it stands still, and what it is
        is returned. Where the object is by now nobody knows: it is not looked for."""
        cell = self._cell
        arm, times = far_path(state.position, cell.posture, cell.settings.arm.joint_speed)
        cell.clearance.clear_table()
        met = cell.clearance.check_path(arm, np.stack([self.fingers(t + each).position for each in times]))
        self.ahead = []
        if met is None:
            self._through_joints(t, state, cell.posture)
            return None
        self.stand_still(state)
        return str(met)

    def stand_still(self, state: HandState) -> None:
        """Keep the arm where it is."""
        self.guide.target.move(self._cell.robot.model.pose(state.position))
        self.guide.let_go()

    def set_touchdown(self, palm: Pose) -> None:
        """`palm`: pose in the world at which the object is let go."""
        self._touchdown = self._cell.robot.flange_for(palm)

    def arrived(self, state: HandState, loose: float = 1.0) -> bool:
        """Whether the flange is at its goal, within `loose` times the tolerance of the settings."""
        decide, goal = self._cell.settings.decide, self.guide.target.pose
        pose = self._cell.robot.model.pose(state.position)
        off, turn = pose.position - goal.position, rotation_between(pose.rotation, goal.rotation)
        return bool(np.linalg.norm(off) < loose * decide.near and np.linalg.norm(turn) < loose * decide.turned)

    def is_over_touchdown(self, state: HandState) -> bool:
        """Whether the flange is where the object is let go, or straight above."""
        base, pose, goal = self._cell.robot.base, self._cell.robot.model.pose(state.position), self._touchdown
        off = base.rotation @ (pose.position - goal.position)
        most = LOOSE * self._cell.settings.decide.near
        return float(np.hypot(off[0], off[1])) < most and off[2] > -most

    def has_come_down(self, state: HandState) -> bool:
        """Whether the object may be let go: the arm is there, or rests above, for a full tray is higher than an empty
        one."""
        rests = self.is_over_touchdown(state) and float(np.abs(state.velocity).max()) < STILL
        return self.is_over(state.t) and (self.arrived(state, LOOSE) or rests)

    def _through_joints(self, t: float, state: HandState, posture: Vector) -> None:
        speed = self._cell.settings.arm.joint_speed
        self._end = max(self._end, self.guide.through_joints(t, state.position, posture, speed))
