"""Live control by a person: an immediate stop, a goal that may move, other gains."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.app import Rig
from allegro_twin.control.path_planning import postures_on_line
from allegro_twin.control.setpoint_filter import SmoothSetpoint
from allegro_twin.control.trajectory import SLOWEST, number
from allegro_twin.errors import ConfigError
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.safety import Guard
from allegro_twin.surfaces.hand.bounds import JointBounds
from allegro_twin.surfaces.hand.motion import MotionControl
from allegro_twin.types import Vector

OWN = "the task's own"
"""The controller of the config, by this name."""
_ROOM = 0.9  # Of a guard's speed: joints overshoot by some hundredths.


class LiveControl:
    """Live control of one hand, as `Hand.direct`. Any thread may call `limp`; all other calls come from one thread."""

    def __init__(self, rig: Rig, mover: MotionControl, bounds: JointBounds) -> None:
        self._rig, self._mover, self._bounds = rig, mover, bounds

    def prepare(self) -> None:
        """Make now what the first wish would wait for."""
        self._mover.paths.touching(self._mover.state.position)

    @property
    def stopped(self) -> bool:
        """Whether the hand was stopped and not yet released."""
        return self._mover.cut

    def limp(self) -> None:
        """No torque from the next period on, without the fade of a change of controllers. Until `release` every wish
        is refused with a CommandError, one that is being planned now among them."""
        self._mover.cut = True

    def release(self) -> None:
        """Take wishes again; the hand stays limp until the first."""
        self._mover.cut = False

    def stay(self) -> None:
        """End a motion where the hand is, for nobody is there to see it. What has arrived stays as it is: a grasp goes
        on pressing, a limp hand is limp. A hand that cannot hold, for nobody says where down is, is left limp."""
        mover, goal = self._mover, self._mover.goal
        if mover.cut or mover.kind == mover.kinds[0]:
            return
        if goal is not None and mover.state.t >= goal.began + goal.seconds:
            return
        try:
            mover.hold(mover.position_kind)
        except ConfigError:
            self.limp()

    @property
    def given_gravity(self) -> Vector | None:
        """The gravity that counts in place of what the hand reports, palm frame, (3,), m/s²; None: what it reports."""
        return self._mover.given_gravity()

    @property
    def target(self) -> Vector:
        """Where the joints should be now, (n,), rad; NaN where the controller wants no position."""
        goal, state = self._mover.goal, self._mover.state
        return np.full(self._rig.spec.n_joints, np.nan) if goal is None else goal.at(state.t)

    @property
    def goal(self) -> Vector:
        """Where the joints are headed, (n,), rad: the posture of `steer` while that is what they do; else their target
        of now, and their position where there is none. A refused posture is none."""
        goal, state = self._mover.goal, self._mover.state
        if goal is None:
            return state.position
        return goal.path.goal if isinstance(goal.path, SmoothSetpoint) else goal.at(state.t)

    def usual_speed(self, usual: float) -> float:
        """A speed for whoever asks for none, rad/s: the usual one, or less where the guard would stop a joint."""
        guard = self._rig.backend
        return min(usual, _ROOM * float(guard.limits.velocity.min())) if isinstance(guard, Guard) else usual

    def steer(self, posture: ArrayLike, speed: float | None = None, what: str = "the goal") -> None:
        """Head straight for a posture, (n,), rad, from whatever the hand is doing for the wish before, without a stop
        between; the joint that travels furthest peaks at about `speed`, rad/s: by default 3, or less where the guard
        would stop a joint. Raises ConfigError for a posture beyond the limits or a speed that the guard would stop,
        SelfCollision where fingers would meet on the straight line: then the hand does what it did."""
        speed = self.usual_speed(3.0) if speed is None else number(speed, "speed, in rad/s,")
        if not SLOWEST <= speed < math.inf:
            raise ConfigError(f"speed must be at least {SLOWEST:g} rad/s, and finite; it is {speed:g}")
        spec, mover = self._rig.spec, self._mover
        goal = self._bounds.admit(posture, what)
        start = np.clip(mover.state.position, spec.lower, spec.upper)
        travel = np.abs(goal - start)
        self._rig.check_speed(speed * travel / max(float(travel.max()), 1e-9), what)
        mover.paths.check_line(postures_on_line(start, goal), what)
        mover.steer(goal, speed, what)

    def use_gains(self, name: str) -> None:
        """Gains of the library from the next wish on. Raises ConfigError."""
        self._mover.gains = load_gains(name, self._rig.spec)

    def perform(self) -> None:
        """What the config's own task and controller do. Raises CommandError while the hand is stopped."""
        self.drive(OWN, self._rig.controller)

    def drive(self, kind: str, controller: Any) -> None:
        """Hand over to any controller, by a name for it. Raises CommandError while the hand is stopped."""
        self._mover.drive(kind, controller)
