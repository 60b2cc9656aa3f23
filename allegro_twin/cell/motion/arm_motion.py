"""Arm motion: far paths in joint space; the last stretch and contact as on a spring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from allegro_twin.cell.arm.impedance import ImpedanceState, SetpointMotion, hung, smoothed_wrench
from allegro_twin.cell.arm.target import CartesianTarget, Smoothing, approach
from allegro_twin.cell.arm.tool import WrenchCompensation
from allegro_twin.control.setpoint_filter import SmoothSetpoint
from allegro_twin.control.time_scaling import minimum_jerk, minimum_jerk_curvature
from allegro_twin.kinematics.arm import ArmModel, rotate, rotation_between
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import HandState, TorqueCommand, Vector

ACCELERATION = 5.0
"""rad/s², of a joint on a far way from rest: two thirds of what the slowest of the FER's may (7.5 rad/s²; libfranka,
rate_limiting.h). A short way at full speed would ask for many times that."""
_QUICK = 30.0
"""rad/s: how fast what is off goes. These paths never jump, so that it may be faster than in
docs/explanation/arm_control.md."""


class SetpointPath(Protocol):
    """Motion of the flange's set-point in the base's frame."""

    def at(self, t: float) -> Pose:
        """Where it is at a time, s."""
        ...

    def motion(self, t: float) -> SetpointMotion:
        """How it moves."""
        ...


class Straight(NamedTuple):
    """Motion from rest to rest on a straight line and by the shortest rotation, with minimum jerk."""

    begin: Pose
    end: Pose
    since: float
    """s."""
    seconds: float

    def at(self, t: float) -> Pose:
        """At a time, s."""
        part, _ = minimum_jerk(self._part(t))
        way = part * self._whole()
        return Pose(self.begin.position + way[:3], rotate(self.begin.rotation, way[3:]))

    def motion(self, t: float) -> SetpointMotion:
        """How it moves at a time, s."""
        s, whole = self._part(t), self._whole()
        twist = minimum_jerk(s)[1] / self.seconds * whole
        return SetpointMotion(twist, minimum_jerk_curvature(s) / self.seconds**2 * whole)

    def _part(self, t: float) -> float:
        return min(max((t - self.since) / self.seconds, 0.0), 1.0)

    def _whole(self) -> Vector:
        """The way and the turn, (6,), m and rad, in the axes that the poses are in."""
        turn = rotation_between(self.begin.rotation, self.end.rotation)
        return np.concatenate([self.end.position - self.begin.position, turn])


class ArmGuide:
    """Goal of the arm: a posture, by a path of its joints, or a pose of the flange. Moved by the states."""

    def __init__(self, posture: Vector, model: ArmModel) -> None:
        self._model = model
        self.target = CartesianTarget(model.pose(posture))
        """The pose, in the base's frame; of the path's end while there is one."""
        self.path: SmoothSetpoint | None = SmoothSetpoint(posture)
        self.line: SetpointPath | None = None
        """How the set-point goes to the target; None: smoothed."""

    def through_joints(self, t: float, position: Vector, posture: Vector, speed: float) -> float:
        """From rest at `position` (n,), rad, to a posture, the fastest joint at `speed`, rad/s. When it is there, s."""
        self.target.move(self._model.pose(posture))
        self.path, self.line = SmoothSetpoint(position), None
        return self.path.head_for(t, posture, speed, ACCELERATION)

    def straight(self, t: float, flange: Pose, seconds: float) -> float:
        """On a spring from the target that there is to another, in the base's frame. When it will be there, s."""
        begin = self.target.pose
        self.target.move(flange)
        self.path, self.line = None, Straight(begin, self.target.pose, t, seconds)
        return t + seconds

    def let_go(self) -> None:
        """From now on the target counts, as on a spring."""
        self.path, self.line = None, None


@dataclass(frozen=True, slots=True, eq=False)
class GuidedImpedance:
    """The controller: τ = M(ω² (q_r - q) + 2ω (q̇_r - q̇)) + C q̇ on a path, impedance off it.

    The spring begins where the path ended, and the elbow likes to stay as it was there. On the spring the joints' dry
    friction is overcome, as of `Impedance`.
    """

    model: ArmModel
    guide: ArmGuide
    stiffness: Vector
    """(6,), N/m and N·m/rad."""
    smoothing: Smoothing
    compensation: WrenchCompensation
    """To what the flange feels, by which friction is overcome."""
    null: float = 10.0
    """N·m/rad, as of `Impedance`."""

    def start(self, state: HandState) -> ImpedanceState:
        return ImpedanceState(self.model.pose(state.position), state.position, state.t)

    def __call__(self, state: HandState, memory: ImpedanceState) -> tuple[TorqueCommand, ImpedanceState]:
        path, line = self.guide.path, self.guide.line
        wrench = smoothed_wrench(self.compensation, self.model, state, memory)
        if path is None:
            goal, dt = self.guide.target.pose, state.t - memory.t
            setpoint = line.at(state.t) if line is not None else approach(memory.setpoint, goal, dt, self.smoothing)
            motion = None if line is None else line.motion(state.t)
            torque = hung(self.model, state, setpoint, memory.rest, self.stiffness, self.null, wrench, motion)
            return TorqueCommand(torque), ImpedanceState(setpoint, memory.rest, state.t, wrench)
        point = path(state.t)
        wanted = _QUICK**2 * (point.position - state.position) + 2.0 * _QUICK * (point.velocity - state.velocity)
        torque = self.model.inertia(state.position) @ wanted + self.model.coriolis(state.position, state.velocity)
        return TorqueCommand(np.asarray(torque)), ImpedanceState(
            self.model.pose(point.position), point.position, state.t, wrench
        )
