"""Wishes of programs outside: set-points that come in a stream, and trajectories that they have timed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.control.setpoint_filter import RateLimitedSetpoint
from allegro_twin.control.trajectory import KnownPath, TimedPath
from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.hand.facade import Hand
from allegro_twin.types import Array, Vector

_STEP = 0.02  # rad between two postures at which a way is looked at.
_MOST = 4000  # Such postures: some seconds of looking.
_HERE = 0.05  # rad. A first posture without a time must be so near.


class ExternalSetpoints:
    """Set-points of other programs for a hand."""

    def __init__(self, hand: Hand, speed: float = 2.0) -> None:
        """`speed`, rad/s: of a set-point's joints at most. Raises ConfigError where the guard would stop one at it."""
        self._hand, self._mover, self._speed = hand, hand._mover, speed
        hand._rig.check_speed(np.full(hand.spec.n_joints, speed), "set-points")
        self._pursuit: RateLimitedSetpoint | None = None
        self._mover.paths.touching(self._mover.state.position)  # Its model is made now, not at the first wish.

    def track(self, posture: ArrayLike, what: str = "joint_cmd") -> Vector:
        """Be at a posture, (n,), rad, and go there at no more than the speed; the next one may come at any time.
        `what` asks stands in messages. What the hand is asked for, (n,), rad: `JointBounds.admit`."""
        goal, pursuit = self._hand._bounds.admit(posture, what), self._driving
        here = self._mover.state.position if pursuit is None else pursuit.goal
        self._look(np.array([here, goal]), what)
        if pursuit is not None:
            pursuit.goal = goal
            return goal
        self._pursuit = RateLimitedSetpoint(goal, self._speed)
        self._mover.follow(self._mover.position_kind, self._pursuit, what)
        return goal

    def nominal(self) -> None:
        """Raises ConfigError for a hand whose fingertips are not where the nominal one has them."""
        fingers = [finger.name for finger in self._hand.spec.fingers]
        self._mover.model.check_closed_form(fingers, self._mover.state.position)

    def rest(self) -> Vector:
        """Go no further than the set-point is now, (n,), rad, which is given back; what presses goes on pressing."""
        pursuit = self._driving
        if pursuit is None:
            return self._mover.state.position
        pursuit.goal = pursuit.position
        return pursuit.goal

    @property
    def _driving(self) -> RateLimitedSetpoint | None:
        """The pursuit, where nothing else drives the hand."""
        goal = self._mover.goal
        return self._pursuit if goal is not None and goal.path is self._pursuit else None

    def follow(self, times: Vector, postures: Array, velocities: Array | None = None, *, late: float = 0.0) -> float:
        """Go through postures, (k, n), rad, at times, (k,), s from now on; with velocities, (k, n), rad/s, on smooth
        curves. How long that takes, s. `late`, s: wait so long first. Raises ConfigError for times that do not
        ascend, for a posture or a speed that a hand cannot have, and SelfCollision."""
        what, here = "joint_trajectory", self._mover.state.position
        times = np.asarray(times, dtype=np.float64)
        if not len(times) or not np.isfinite(times).all() or times[0] < 0.0 or (np.diff(times) <= 0.0).any():
            raise ConfigError(f"{what}: time_from_start must ascend from 0, s; it is {_few(times)}")
        if len(postures):
            postures = np.array([self._hand._bounds.admit(row, what) for row in postures])
        if times[0] < 1e-9:
            if (off := float(np.abs(postures[0] - here).max())) > _HERE:
                raise ConfigError(f"{what}: its first point is {off:.2f} rad from the hand, at once: give it a time")
            times, postures = times[1:], postures[1:]
            velocities = None if velocities is None else velocities[1:]
        if not len(times):
            return 0.0
        path = _through(here, times + late, postures, velocities, late)
        self._check(path, what)
        self._mover.follow(self._mover.position_kind, KnownPath(path), what)
        return path.seconds

    def _check(self, path: TimedPath, what: str) -> None:
        spans = np.abs(np.diff(path.postures, axis=0)).max(axis=1)
        self._hand._rig.check_speed(path.peak, what)
        count = int(min(max(math.ceil(float(spans.sum()) / _STEP), 2 * len(path.times), 20), _MOST))
        points = [path(t) for t in np.linspace(0.0, path.seconds, count)]
        rows = np.array([point.position for point in points])
        (lower, upper), start = self._hand.limits, rows[0]
        least, most = np.minimum(lower, start), np.maximum(upper, start)  # A joint that rests beyond them comes back.
        for row in rows[1:]:  # A smooth curve may swing beyond the postures that it goes through.
            if said := self._hand.spec.limit_violation(row, least, most, 1e-9):
                raise ConfigError(f"{what}: on its way, {said}")
        self._look(rows, what)

    def _look(self, rows: Array, what: str) -> None:
        if len(rows) == 2:
            steps = max(int(np.ceil(np.abs(rows[1] - rows[0]).max() / _STEP)), 1)
            rows = np.linspace(rows[0], rows[1], steps + 1)
        self._mover.paths.check_line(rows, what)


def _through(here: Vector, times: Vector, postures: Array, velocities: Array | None, late: float) -> TimedPath:
    """From where the hand is, at rest."""
    lead = [0.0] if late <= 0.0 else [0.0, late]
    still = np.repeat(here[None], len(lead), axis=0)
    rates = None if velocities is None else np.vstack([np.zeros_like(still), velocities])
    return TimedPath(np.concatenate([lead, times]), np.vstack([still, postures]), rates)


def _few(times: Vector) -> str:
    text = ", ".join(f"{t:g}" for t in times[:6])
    return text + (", …" if len(times) > 6 else "") if len(times) else "empty"
