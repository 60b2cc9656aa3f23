"""Workspace limits of a cell that is controlled from outside: every request is checked before anything moves."""

from __future__ import annotations

import math

import numpy as np

from allegro_twin.cell.arm.target import CartesianTarget
from allegro_twin.cell.assembly import Cell
from allegro_twin.control.trajectory import TimedPath
from allegro_twin.errors import CommandError, ConfigError
from allegro_twin.kinematics.arm import rotate, rotation_between
from allegro_twin.kinematics.pose import Pose, compose
from allegro_twin.safety import check_speed
from allegro_twin.sim.contact.self_clearance import SelfClearance
from allegro_twin.types import Array, Vector

_STEP, _TURN = 0.05, 0.3
"""m and rad between two places of a way at which it is looked at."""
_MOST = 40  # Such places.
_NEAR = 5e-3  # m and rad: how exactly the arm has to reach them on paper.
_ROOM = 0.05  # rad, to the end of every joint.
_TICK, _LONGEST = 0.02, 4000
"""s between two postures of the fingers that are looked at, and so many of them at most in a clearance."""
_IN_A_LEG = 4  # Moments of every leg, however short: a fast one must not lie between two ticks.
_GIVES = 0.002  # m. As in `collision_free_paths`: depth to which fingers may overlap.


class WorkspaceLimits:
    """Refuses with CommandError, in a sentence; what it lets through the cell can do."""

    def __init__(self, cell: Cell) -> None:
        self._cell, self._bounds = cell, cell.settings.follow
        self._apart = SelfClearance(cell.hand.spec)

    def check_palm(self, palm: Pose, here: Pose, now: Vector, fingers: Vector) -> Pose:
        """The palm's pose, in the world, checked: the arm gets there from `here`, on a straight line, with its joints
        at first at `now` (n,), rad, and the hand, in a posture (n,), rad, is over the table then."""
        robot, palm = self._cell.robot, CartesianTarget(palm).pose
        low, high = np.array(self._bounds.lower), np.array(self._bounds.upper)
        if (palm.position < low).any() or (palm.position > high).any():
            raise CommandError(
                f"target {_place(palm.position)} is outside {self._bounds.lower} to {self._bounds.upper} m: the arm "
                "stays; ask for a place inside, or set `follow`"
            )
        self._over(palm, fingers, "target")
        way, left, at = palm.position - here.position, rotation_between(here.rotation, palm.rotation), now
        parts = math.ceil(max(float(np.linalg.norm(way)) / _STEP, float(np.linalg.norm(left)) / _TURN, 1.0))
        for part in np.linspace(0.0, 1.0, min(parts, _MOST) + 1)[1:]:
            pose = Pose(here.position + part * way, rotate(here.rotation, part * left))
            try:
                at = robot.model.reach(robot.flange_for(pose), at, _NEAR)
            except ConfigError as error:
                raise CommandError(f"target {_place(palm.position)}: the arm stays: {error}") from error
            self._joints(at, palm)
        return palm

    def check_fingers(self, path: TimedPath, palm: Pose) -> None:
        """Look at a path of the fingers, with the palm at a pose of the world."""
        spec = self._cell.hand.spec
        legs = np.linspace(path.times[:-1], path.times[1:], _IN_A_LEG, endpoint=False).ravel()
        count = min(max(int(path.seconds / _TICK), 2), _LONGEST)
        times = np.unique(np.concatenate([legs, np.linspace(0.0, path.seconds, count)]))
        try:
            check_speed(path.peak, self._cell.robot.hand.limits, spec, "fingers")
        except ConfigError as error:
            raise CommandError(str(error)) from error
        rows = np.array([path(t).position for t in times])
        least, most = np.minimum(spec.lower, rows[0]), np.maximum(spec.upper, rows[0])
        for row in rows[1:]:  # A joint that rests beyond its limit comes back.
            if said := spec.limit_violation(row, least, most, 1e-9):
                raise CommandError(f"fingers: {said}")
        thin = math.ceil(len(rows) / _LONGEST)
        rows, times = rows[::-thin][::-1], times[::-thin][::-1]
        apart = self._apart(rows[1:])
        if apart.min() < -_GIVES:
            moment, pair = np.unravel_index(int(apart.argmin()), apart.shape)
            one, other = self._apart.pairs[pair]
            said = f"{one} and {other} would meet after {times[1 + moment]:.2f} s"
            raise CommandError(f"fingers: {said}; go round")
        for row in rows[:: -max(len(rows) // 20, 1)]:
            self._over(palm, row, "fingers")

    def _joints(self, at: Vector, palm: Pose) -> None:
        spec = self._cell.robot.spec
        cell = np.minimum(at - spec.lower, spec.upper - at)
        if cell.min() < _ROOM:
            joint = spec.joints[int(cell.argmin())]
            raise CommandError(
                f"target {_place(palm.position)}: on the way {joint} would come to its end: the arm stays; ask for one "
                "nearer, or turned less"
            )

    def _over(self, palm: Pose, fingers: Vector, what: str) -> None:
        model = self._cell.model
        parts = {"the palm": Pose(np.zeros(3), np.eye(3)), **model.links(fingers)}
        tips = {f"the tip of {name}": pose for name, pose in model.fingertips(fingers).items()}
        heights = {name: float(compose(palm, pose).position[2]) for name, pose in (parts | tips).items()}
        lowest = min(heights, key=lambda name: heights[name])
        short = self._bounds.clearance - heights[lowest]
        if short > 0.0:
            where = "in" if heights[lowest] < 0.0 else "too near to"
            raise CommandError(
                f"{what}: {lowest} would be {where} the table, at {1e3 * heights[lowest]:.0f} mm: nothing moves; ask "
                f"for {1e3 * short:.0f} mm more"
            )


def _place(position: Array) -> str:
    return "(" + ", ".join(f"{x:.3f}" for x in position) + ") m"
