"""What moves the fingers of many candidates side by side while physics tries them: torques, or the hand's own loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from allegro_twin.control.controllers import Gains, GravityTorque
from allegro_twin.grasping.plan.close_in_geometry import units
from allegro_twin.sim.batch.cpu import Rows, SimBatch
from allegro_twin.types import Array

CAP = 0.45
"""Of their torque limit that fingers close with."""
OVER = 1.15
"""A position grasp is told to go so much further than the torque needs: contacts give."""
SECONDS, RISE = 0.45, 0.1
"""s that closing takes at least, and until fingers press as hard as they are to."""
SPEED = 4.0
"""rad/s at most at which what closes is to turn."""


@dataclass(frozen=True, slots=True)
class Performer:
    """What holds joints where they are told to be."""

    gains: Gains
    """Of the controller, or of the loop that the hand closes."""
    gravity: GravityTorque


class Fingers(Protocol):
    """Both ways give what `SimBatch.advance` tells the motors of some rows in a period, (rows, n)."""

    @property
    def seconds(self) -> float:
        """That closing takes."""
        ...

    def press(self, rows: Rows, at: float) -> Array:
        """While joints close, `at` s after they have begun: with a share of their torque; the others stay."""
        ...

    def go(self, rows: Rows, target: Array) -> Array:
        """To positions, (candidates, n), rad, with all that they have."""
        ...


def fingers_of(sims: SimBatch, performer: Performer, start: Array, closing: Array, close: Array) -> Fingers:
    """`start`: where they begin, `closing`: which way they go, and `close`: where geometry has them meet something,
    (candidates, n)."""
    if not sims.closes_loop:
        return Torqued(sims, performer, start.copy(), closing)
    return Own(sims, performer, start.copy(), closing, close)


@dataclass(frozen=True, slots=True, eq=False)
class Torqued:
    """Fingers that take torques: PD, and their weight carried."""

    sims: SimBatch
    performer: Performer
    start: Array
    closing: Array

    @property
    def seconds(self) -> float:
        return SECONDS

    def press(self, rows: Rows, at: float) -> Array:
        gains, sims = self.performer.gains, self.sims
        push = min(1.0, at / RISE) * CAP * sims.spec.actuation.torque_limit * self.closing - gains.kd * sims.velocity
        stay = gains.kp * (self.start - sims.position) - gains.kd * sims.velocity
        return self._carried(rows, np.where(self.closing != 0.0, push, stay))

    def go(self, rows: Rows, target: Array) -> Array:
        gains, sims = self.performer.gains, self.sims
        return self._carried(rows, gains.kp * (target - sims.position) - gains.kd * sims.velocity)

    def _carried(self, rows: Rows, torque: Array) -> Array:
        wanted, down, sims = torque[rows], self.sims.gravity, self.sims
        for place, row in enumerate(rows.tolist()):
            wanted[place] += self.performer.gravity(sims.position[row], down[row])
        return wanted


@dataclass(frozen=True, slots=True, eq=False)
class Own:
    """Fingers whose firmware closes the loop: they are told to go evenly to a little beyond where they should meet the
    object, with a share of their effort where the hand can limit it."""

    sims: SimBatch
    performer: Performer
    start: Array
    closing: Array
    close: Array

    @property
    def seconds(self) -> float:
        travel = np.abs(self._goal() - self.start) / units(self.sims.spec)
        return max(SECONDS, float(travel.max()) / SPEED)

    def press(self, rows: Rows, at: float) -> Array:
        limit, goal = self.sims.spec.actuation.torque_limit, self._goal()[rows]
        limited = "limited_position" in self.sims.spec.commands
        effort = np.tile(CAP * limit if limited else limit, (len(rows), 1))
        wanted = self.start[rows] + min(1.0, at / (0.8 * self.seconds)) * (goal - self.start[rows])
        return self.sims.servo_control(rows, wanted, effort)

    def go(self, rows: Rows, target: Array) -> Array:
        return self.sims.servo_control(rows, target[rows])

    def _goal(self) -> Array:
        spec = self.sims.spec
        beyond = OVER * CAP * spec.actuation.torque_limit / self.performer.gains.kp
        goal: Array = np.clip(self.close + beyond * self.closing, spec.lower, spec.upper)
        return np.where(self.closing != 0.0, goal, self.start)
