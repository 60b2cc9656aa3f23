"""What drives the hand behind the facade: which controller, towards what, since when."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from allegro_twin.build import Rig
from allegro_twin.control.controllers import PD, PID, Gains, Gravity, GravityCompensation, Torque
from allegro_twin.control.handover import Relay
from allegro_twin.control.trajectory import Hold, Path, Reference
from allegro_twin.hand.driver import Driver
from allegro_twin.kinematics.model import HandModel
from allegro_twin.loop import paced, run
from allegro_twin.types import HandState, Sample, Vector

Kind: TypeAlias = Literal["torque", "gravity", "pd", "pid"]
KINDS: tuple[Kind, ...] = ("torque", "gravity", "pd", "pid")
_SETTLED, _STILL, _PATIENCE = 0.02, 0.05, 0.5  # rad, rad/s, s.


class Goal(NamedTuple):
    """What the joints are asked to do: a path, when it began and for how long it lasts, s."""

    path: Path
    began: float
    seconds: float

    def at(self, t: float) -> Vector:
        """Where the joints should be, (n,), rad."""
        return self.path(t - self.began).position


class Mover:
    """Turns wishes into controllers and hands the hand over to them, and waits for what they do."""

    def __init__(self, rig: Rig, gains: Gains, *, background: bool) -> None:
        self._rig, self._gains = rig, gains
        self.model = HandModel(rig.spec)
        self.kind: Kind | str = "torque"
        self.goal: Goal | None = None
        self.listeners: list[Callable[[Sample], None]] = []
        self._gravity = Gravity(self.model.gravity_torque)
        self._relay = Relay(Torque(np.zeros(rig.spec.n_joints)), rig.spec.actuation.torque_limit)
        self.driver = Driver(self._samples(background), background=background)

    @property
    def state(self) -> HandState:
        return self.driver.latest.state

    @property
    def gains(self) -> Gains:
        return self._gains

    @property
    def gravity(self) -> Gravity:
        """The feed-forward. Raises ConfigError when nobody says where down is."""
        self._gravity.check(self.state)
        return self._gravity

    def set_gravity(self, vector: Vector | None) -> None:
        """Compensate this gravity from now on, or what the hand reports for None."""
        self._gravity = Gravity(self.model.gravity_torque, vector)
        self._relay.amend(lambda c: replace(c, gravity=self._gravity) if getattr(c, "gravity", None) is not None else c)

    def given_gravity(self) -> Vector | None:
        return self._gravity.vector

    def drive(self, kind: Kind | str, controller: Any, goal: Goal | None = None) -> None:
        """Hand over to a controller; `goal` says what its motion is, for those who wait."""
        self.kind, self.goal = kind, goal
        self._relay.switch(controller)

    def limp(self, torque: Vector) -> None:
        self.drive("torque", Torque(torque))

    def compensate(self) -> None:
        self.drive("gravity", GravityCompensation(self.gravity))

    def hold(self, kind: Kind) -> None:
        """Stay where the hand is."""
        self.follow(kind, Hold(self.state.position))

    def follow(self, kind: Kind, reference: Reference) -> None:
        """Let PD or PID follow a reference from the present state on."""
        gravity, state = self.gravity, self.state
        limit = self._rig.spec.actuation.torque_limit
        controller = (
            PD(reference, self._gains, gravity) if kind == "pd" else PID(reference, self._gains, limit, gravity)
        )
        path = reference.begin(state.position)
        self.drive(kind, controller, Goal(path, state.t, float(getattr(path, "seconds", 0.0))))

    def wait(self) -> HandState:
        """Until the motion is over and the joints have settled, or half a second after it."""
        goal = self.goal
        return self.driver.wait(lambda sample: goal is None or self._arrived(sample.state, goal)).state

    def _arrived(self, state: HandState, goal: Goal) -> bool:
        late = state.t - (goal.began + goal.seconds + self._rig.backend.period)
        settled = np.abs(goal.at(state.t) - state.position).max() < _SETTLED and np.abs(state.velocity).max() < _STILL
        return late >= _PATIENCE or (late >= 0.0 and bool(settled))

    def _samples(self, background: bool) -> Iterator[Sample]:
        samples = run(self._rig.backend, self._relay)
        for sample in paced(samples) if background and self._rig.sim is not None else samples:
            for listener in tuple(self.listeners):
                listener(sample)
            yield sample
