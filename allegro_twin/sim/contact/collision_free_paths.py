"""Collision-free paths of the fingers from one posture to another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from allegro_twin.control.path_planning import CLEARANCE, PlanningSpace, crossing_pairs, plan_path, postures_on_line
from allegro_twin.control.trajectory import Moves, SpeedCheck, Trajectory, Waypoint, travel_time
from allegro_twin.errors import SelfCollision
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

if TYPE_CHECKING:
    from allegro_twin.sim.contact.self_clearance import SelfClearance

_GIVES = 0.002  # m. So deep in each other parts may be asked to be: skin gives, and no model is better than that.
_LEAST = 0.15  # s. A short leg in less than that would ask for more than the motors have.
_CAREFUL = 1.5  # rad/s. Where fingers pass each other narrowly, or wait for each other: a fast one lags behind.
_TOUCHING = 0.001  # m. A finger that has given up its torque may stand so far from what has stopped it.
_WIDELY = 0.008  # m. Distance up to which `self_clearance` looks.
NEARLY = 0.002  # m. Of what stops a joint, where encoders and model are that far from the real fingertips.
SHIFTED = 0.02
"""rad. A limp hand that moved by more while its way was sought needs another way."""
_PUSH, _NEARER = 0.01, 1e-5  # rad that a joint is tried further on; m by which it then comes nearer, at least.


class CollisionFreePaths:
    """Ways of one hand. The model that tells how near its parts are to each other is made at the first question."""

    def __init__(self, spec: HandSpec, check: SpeedCheck | None = None) -> None:
        """`check`: looks at the speeds of every way, and of what it was asked for."""
        self._spec, self._check_speed = spec, check

    def legs(
        self, start: Vector, goal: Waypoint, limits: tuple[Vector, Vector], what: str, *, margin: float = 0.0,
        deepest: float = _GIVES,
    ) -> list[Waypoint]:  # fmt: skip
        """The goal from a posture (n,), rad, inside joint limits, behind the detours that it needs: none where nothing
        is in the way. `margin`: distance kept on the way beyond the usual one, m, for a hand that is not quite where it
        says; `deepest`: how deep in each other the parts may be at the goal, m. Raises ConfigError for a wrong speed,
        and SelfCollision for a posture that the hand cannot have or that no way was found to; `what` it is stands in
        the message."""
        self._check_legs(start, [goal], what)
        found = self._found(start, goal, limits, what, margin, deepest)
        self._check_legs(start, found, what)
        return found

    def _check_legs(self, start: Vector, legs: Sequence[Waypoint], what: str) -> None:
        path = Moves(legs).begin(start)
        if self._check_speed is not None:
            self._check_speed(path.peak, what)

    def _found(
        self, start: Vector, goal: Waypoint, limits: tuple[Vector, Vector], what: str, margin: float, deepest: float
    ) -> list[Waypoint]:
        self._check(goal.posture, what, deepest)
        fingers = [finger.joints for finger in self._spec.fingers]
        room = PlanningSpace(lambda rows: self._apart(rows) - margin, fingers, np.clip(0.0, *limits), *limits)
        found = plan_path(room, start, goal.posture)
        if found is None:
            apart = self._apart(postures_on_line(start, goal.posture))
            parts = self._nearest(apart, crossing_pairs(apart, CLEARANCE))
            raise SelfCollision(f"{what}: found no way from here on which {parts} keep clear; go by another posture")
        careful = replace(goal, speed=min(goal.speed, _CAREFUL))
        if len(found) == 1:
            wide = careful.speed == goal.speed or self._apart(postures_on_line(start, goal.posture)).min() >= _WIDELY
            return [goal if wide else careful]
        legs = [replace(careful, posture=posture) for posture in found]
        times = [max(travel_time(a, leg), _LEAST) for a, leg in zip([start, *found], legs, strict=False)]
        return [Waypoint(leg.posture, seconds, profile=leg.profile) for leg, seconds in zip(legs, times, strict=True)]

    def check_line(self, rows: Array, what: str) -> None:
        """Raises SelfCollision where postures along a line, (k, n), rad, bring the hand to meet itself on the way, or
        further into itself than it gives at the end."""
        self._check(rows[-1], what)
        apart = self._apart(rows)
        if (met := crossing_pairs(apart, 0.0)).any():
            raise SelfCollision(f"{what}: {self._nearest(apart, met)} meet on the straight line there; go round")

    def touching(self, posture: Vector, within: float = _TOUCHING) -> list[tuple[str, str]]:
        """Which parts of the hand touch each other in a posture, (n,), rad, or are as near as a press leaves them."""
        apart = self._apart(posture[None])[0]
        return [pair for pair, distance in zip(self._clearance.pairs, apart, strict=True) if distance < within]

    def blocking_parts(self, posture: Vector, towards: Vector) -> dict[int, str]:
        """What stops joints that are to go on in a direction, both (n,), rad: by joint, which part of the hand
        is in the way of which, where it presses two together that touch."""
        spec, turns = self._spec, np.sign(towards)
        apart, *tried = self._apart(np.vstack([posture, posture + _PUSH * np.diag(turns)]))
        found = {}
        for finger, joint in [(each.name, joint) for each in spec.fingers for joint in each.joints]:
            pressed = (apart < NEARLY) & (tried[joint] < apart - _NEARER)
            if turns[joint] and pressed.any():
                one, other = self._clearance.pairs[int(np.argmin(np.where(pressed, apart, np.inf)))]
                blocking = other if one == finger else one
                found[joint] = f"{blocking} is in the way of {'itself' if blocking == finger else finger}"
        return found

    @cached_property
    def _clearance(self) -> SelfClearance:
        from allegro_twin.sim.contact.self_clearance import SelfClearance

        return SelfClearance(self._spec)

    def _apart(self, postures: Array) -> Array:
        return self._clearance(postures)

    def _check(self, posture: Vector, what: str, deepest: float = _GIVES) -> None:
        apart = self._apart(posture[None])
        if apart.min() < -deepest:
            deep = -apart.min() * 1000
            raise SelfCollision(f"{what}: {self._nearest(apart)} would be {deep:.1f} mm inside each other")

    def _nearest(self, apart: Array, among: NDArray[np.bool_] | None = None) -> str:
        """The parts that come nearest, distances (k, pairs), m; among some of the pairs, if it is any of them."""
        least = apart.min(axis=0)
        if among is not None and among.any():
            least = np.where(among, least, np.inf)
        a, b = self._clearance.pairs[int(np.argmin(least))]
        return f"two links of {a}" if a == b else f"{a} and {b}"


class CollisionFreeMove:
    """A reference: to a posture, from where the fingers are, without one meeting another. `what` it is stands in
    messages."""

    def __init__(self, spec: HandSpec, goal: Waypoint, what: str, check: SpeedCheck | None = None) -> None:
        self.waypoints: Sequence[Waypoint] = [goal]
        """What was asked for, without the detours."""
        self._spec, self._what = spec, what
        self._paths, self._limits = CollisionFreePaths(spec, check), (spec.lower, spec.upper)
        self._planned: tuple[Vector, list[Waypoint]] | None = None

    def checked(self, check: SpeedCheck) -> CollisionFreeMove:
        """Copy whose motion `check` examines before it begins."""
        (goal,) = self.waypoints
        return CollisionFreeMove(self._spec, goal, self._what, check)

    def prepare(self, position: Vector) -> None:
        """Plan the path from a joint position, (n,), rad: in 10 ms where it is straight, up to 0.7 s where it is not.
        Raises SelfCollision as `CollisionFreePaths.legs` does."""
        (goal,) = self.waypoints
        self._planned = position, self._paths.legs(np.clip(position, *self._limits), goal, self._limits, self._what)

    def begin(self, position: Vector) -> Trajectory:
        """The path, planned now unless it was for a position next to this one. Raises SelfCollision."""
        if self._planned is None or np.abs(self._planned[0] - position).max() > SHIFTED:
            self.prepare(position)
        assert self._planned is not None
        return Moves(self._planned[1]).begin(position)
