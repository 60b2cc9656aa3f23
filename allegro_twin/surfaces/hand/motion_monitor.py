"""Whether a motion has arrived, is under way, or has met something."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from allegro_twin.control.controllers import Gains
from allegro_twin.control.trajectory import Path
from allegro_twin.spec import HandSpec
from allegro_twin.types import HandState, Sample, TorqueCommand, Vector

_SETTLED, _STILL, _PATIENCE = 0.02, 0.05, 0.5  # rad, rad/s, s.
_SHORT = 0.03  # rad. A joint further from where it should be is not there.
_MOVED, _STUCK = 0.01, 0.5  # rad, s. A joint that should move and has not moved so far in that time is stuck.
_FULL = 0.99  # Of its clip: a joint that is given so much should move.
_LATEST = 3.0  # s after the end. What shakes in a contact instead of coming to rest is stuck as well.


class Goal(NamedTuple):
    """What the joints are asked to do: a path, when it began and for how long it lasts, s."""

    path: Path
    began: float
    seconds: float
    what: str = "the motion"
    """For messages."""
    pressing: float = 0.0
    """From when on it may press, s since it began: being stopped is then what it is for."""

    def at(self, t: float) -> Vector:
        """Where the joints should be, (n,), rad."""
        return self.path(t - self.began).position


class Watch:
    """Follows a motion sample by sample until it has arrived or is stuck."""

    def __init__(self, goal: Goal, spec: HandSpec, gains: Gains, period: float) -> None:
        self.goal, self.arrived = goal, False
        self._spec, self._over = spec, goal.began + goal.seconds + period
        # What dry friction alone keeps from its place is not stuck.
        self._short = np.maximum(_SHORT, 2.0 * spec.actuation.frictionloss / np.maximum(gains.kp, 1e-9))
        self._full = _FULL * spec.actuation.torque_limit
        self._place, self._since = np.full(spec.n_joints, np.inf), np.zeros(spec.n_joints)
        self._stuck: dict[str, float] = {}

    def __call__(self, sample: Sample) -> bool:
        """Look at the newest sample: whether the motion is stuck."""
        if self.arrived:
            return False
        state = sample.state
        late, error = state.t - self._over, self.goal.at(state.t) - state.position
        over = late >= _PATIENCE or (late >= 0.0 and _settled(error, state))
        if state.t - self.goal.began >= self.goal.pressing:
            self.arrived = over
            return False
        pushing = np.abs(error) > self._short
        if isinstance(sample.command, TorqueCommand):
            pushing |= np.abs(sample.command.torque) >= self._full
        resting = np.abs(state.position - self._place) < _MOVED
        self._place = np.where(resting, self._place, state.position)
        self._since = np.where(resting & pushing, self._since, state.t)
        stuck = pushing & ((state.t - self._since >= _STUCK) | (late >= _LATEST))
        self._stuck = {self._spec.joint_labels[k]: float(abs(error[k])) for k in np.flatnonzero(stuck)}
        self.arrived = over and not pushing.any()
        return bool(self._stuck)

    @property
    def words(self) -> str:
        """What is stuck, the furthest from its place first."""
        worst = sorted(self._stuck.items(), key=lambda item: -item[1])
        rest = f" and {len(worst) - 3} more" if len(worst) > 3 else ""
        return ", ".join(f"{name} {short:.2f} rad" for name, short in worst[:3]) + rest


def _settled(error: Vector, state: HandState) -> bool:
    return bool(np.abs(error).max() < _SETTLED and np.abs(state.velocity).max() < _STILL)
