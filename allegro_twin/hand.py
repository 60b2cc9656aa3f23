"""`Hand`, the facade for people at a prompt: everything the hand can do, on any backend."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import TracebackType
from typing import Any, Literal, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.build import Rig, assemble
from allegro_twin.config import PositionSettings, RunConfig, load_config
from allegro_twin.control.controllers import PD, PID, Gains, Gravity, GravityCompensation, Torque
from allegro_twin.control.handover import Relay
from allegro_twin.control.teach import Taught, taught
from allegro_twin.control.trajectory import Following, Hold, Moves, Path, Profile, Reference, Waypoint
from allegro_twin.driver import Driver
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.kinematics.model import HandModel, Pose
from allegro_twin.library.gains import load_gains
from allegro_twin.library.postures import load_posture
from allegro_twin.loop import paced, run
from allegro_twin.spec import HandSpec
from allegro_twin.types import HandState, Sample, Vector, frozen

Kind: TypeAlias = Literal["torque", "gravity", "pd", "pid"]
KINDS: tuple[Kind, ...] = ("torque", "gravity", "pd", "pid")
Posture: TypeAlias = str | ArrayLike
"""A name in the library, or joint positions, shape (n,), rad."""


class Goal(NamedTuple):
    """What the joints are asked to do: a path, and when it began, s."""

    path: Path
    began: float


class Lesson:
    """What happens while somebody teaches."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, Vector]] = []

    def __call__(self, sample: Sample) -> None:
        self._rows.append((sample.state.t, sample.state.position))

    def posture(self) -> Vector:
        """Where the fingers were left, (n,), rad."""
        if not self._rows:
            raise ConfigError("nothing was taught: no time has passed in the lesson; hand.wait(seconds) lets it")
        return self._rows[-1][1]

    def motion(self, tolerance: float = 0.004) -> Taught:
        """The way they went, trimmed and simplified to within `tolerance` (rad)."""
        self.posture()
        times, positions = zip(*self._rows, strict=True)
        return taught(np.array(times), np.array(positions), tolerance=tolerance)


class Hand:
    """A hand to work with.

    It opens limp. In a simulation and a replay time passes only in calls that wait, so a script repeats itself bit for
    bit; with `background=True` it passes on its own in real time. Every way out of `with` leaves the hand limp.
    """

    def __init__(self, rig: Rig, gains: Gains, *, background: bool = False) -> None:
        self._rig, self._gains = rig, gains
        self._model = HandModel(rig.spec)
        self._gravity = Gravity(self._model.gravity_torque)
        self._kind: Kind = "torque"
        self._goal: Goal | None = None
        self._margin: Vector = np.zeros(rig.spec.n_joints)
        self.use_margin = False
        self._listeners: list[Callable[[Sample], None]] = []
        self._relay = Relay(Torque(np.zeros(rig.spec.n_joints)), rig.spec.actuation.torque_limit)
        self._driver = Driver(self._samples(background), background=background)

    @classmethod
    def open(cls, config: str | pathlib.Path | RunConfig, *, background: bool = False) -> Self:
        """Open the hand that a config describes; its `controller` block names the gains. Raises HandError."""
        settings = config if isinstance(config, RunConfig) else load_config(config)
        rig = assemble(settings)
        controller = settings.controller
        name = controller.gains if isinstance(controller, PositionSettings) else "default"
        return cls(rig, load_gains(name, rig.spec), background=background)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave the hand limp and let go of it. Idempotent."""
        self._driver.close()
        self._rig.backend.close()

    @property
    def spec(self) -> HandSpec:
        return self._rig.spec

    @property
    def state(self) -> HandState:
        """The newest state."""
        return self._driver.latest.state

    @property
    def controllers(self) -> tuple[Kind, ...]:
        """What `set_controller` takes."""
        return KINDS

    @property
    def controller(self) -> Kind:
        """What drives the hand now."""
        return self._kind

    def set_controller(self, kind: Kind, *, torque: ArrayLike = 0.0) -> None:
        """Change the controller while the hand runs, without a jump of torque. `pd` and `pid` stay where the hand is;
        `torque` (N·m, one value or n) is for the torque controller. Raises ConfigError."""
        if kind not in KINDS:
            raise ConfigError(unknown("controller", kind, KINDS))
        if kind == "torque":
            self._switch(kind, Torque(self.spec.vector(torque, "torque")), None)
        elif kind == "gravity":
            self._switch(kind, GravityCompensation(self._checked_gravity()), None)
        else:
            self._follow(kind, Hold(self.state.position))

    @property
    def errors(self) -> Vector:
        """Where the joints should be less where they are, (n,), rad; NaN where the controller wants no position."""
        sample = self._driver.latest
        target = self._target(sample.state)
        return frozen(np.full(self.spec.n_joints, np.nan) if target is None else target - sample.state.position)

    @property
    def gravity(self) -> Vector:
        """The gravity that controllers compensate, palm frame, (3,), m/s²."""
        return self.state.gravity if self._gravity.vector is None else self._gravity.vector

    @gravity.setter
    def gravity(self, vector: ArrayLike | None) -> None:
        """Set it where the hand reports none or is wrong about it; None: what the hand reports."""
        if vector is not None:
            vector = frozen(vector)
            if vector.shape != (3,) or not np.isfinite(vector).all():
                raise ConfigError(f"gravity needs three finite numbers in the palm frame, m/s²; not {vector}")
        self._gravity = Gravity(self._model.gravity_torque, vector)
        if self._kind != "torque":
            self._relay.amend(lambda controller: replace(controller, gravity=self._gravity))

    def move_to(
        self, posture: Posture, speed: float = 1.0, *, profile: Profile = "minimum_jerk", wait: bool = True
    ) -> None:
        """Go to a posture: the joint that travels furthest peaks at `speed` (rad/s), all arrive together. From torque
        or gravity compensation the hand changes to PID. Raises ConfigError before anything moves."""
        goal = self._posture(posture)
        moves = Moves([Waypoint(goal, speed=speed, profile=profile)])
        moves.begin(self.state.position)  # A wrong speed is an error here, not in the loop.
        self._follow(self._kind if self._kind in ("pd", "pid") else "pid", moves)
        if wait:
            self.wait()

    def fingertips(self) -> dict[str, Pose]:
        """Position (m) and rotation of every fingertip in the palm frame."""
        return self._model.fingertips(self.state.position)

    def wait(self, seconds: float | None = None) -> HandState:
        """Let time pass: so many seconds of the hand's clock, or until the motion is over and the joints have settled
        (0.02 rad, or half a second at most)."""
        if seconds is not None:
            end = self.state.t + seconds
            return self._driver.wait(lambda sample: sample.state.t >= end - 1e-9).state
        goal = self._goal
        return self._driver.wait(lambda sample: self._arrived(sample, goal)).state

    def stop(self) -> None:
        """Stay here: PID at the present position."""
        self._follow("pid", Hold(self.state.position))

    @property
    def limits(self) -> tuple[Vector, Vector]:
        """Lowest and highest joint positions that motions may ask for, margin included, (n,) each, rad."""
        margin = self._margin if self.use_margin else 0.0
        return frozen(self.spec.lower + margin), frozen(self.spec.upper - margin)

    def set_margin(
        self,
        general: float | None = None,
        *,
        percent: float | None = None,
        per_joint: ArrayLike | None = None,
    ) -> None:
        """Stay away from the joint limits: by one distance (rad), a percentage of each joint's range, or n distances.
        `use_margin` turns it on and off. Raises ConfigError unless one is given and leaves every joint a range."""
        given = [value for value in (general, percent, per_joint) if value is not None]
        if len(given) != 1:
            raise ConfigError(f"set_margin takes one of general, percent and per_joint; {len(given)} are given")
        margin = self.spec.vector(given[0], "margin")
        if percent is not None:
            margin = margin / 100.0 * (self.spec.upper - self.spec.lower)
        if (margin < 0).any() or (2 * margin >= self.spec.upper - self.spec.lower).any():
            raise ConfigError(f"a margin of {given[0]} leaves some joint no range, or is negative")
        self._margin, self.use_margin = margin, True

    @contextmanager
    def teach(self) -> Iterator[Lesson]:
        """Gravity compensation while somebody moves the fingers; what happens is kept in the lesson. Afterwards the
        hand holds where it was left."""
        lesson = Lesson()
        self.set_controller("gravity")
        self._listeners.append(lesson)
        try:
            yield lesson
        finally:
            self._listeners.remove(lesson)
        self.stop()

    def play(self, motion: Taught, speed: float = 1.0, *, approach: float = 1.0, wait: bool = True) -> None:
        """Go to where a taught motion begins (peak speed `approach`, rad/s), then repeat it `speed` times as fast."""
        path = motion.path(speed)
        for row in motion.positions:
            self._posture(row)
        self.move_to(motion.positions[0], approach)
        self._follow("pid", Following(path))
        if wait:
            self.wait()

    def listen(self, listener: Callable[[Sample], None]) -> None:
        """Call somebody with every sample: a scripted guide, a plot."""
        self._listeners.append(listener)

    def _samples(self, background: bool) -> Iterator[Sample]:
        samples = run(self._rig.backend, self._relay)
        for sample in paced(samples) if background and self._rig.sim is not None else samples:
            for listener in tuple(self._listeners):
                listener(sample)
            yield sample

    def _switch(self, kind: Kind, controller: Any, goal: Goal | None) -> None:
        self._kind, self._goal = kind, goal
        self._relay.switch(controller)

    def _follow(self, kind: Kind, reference: Reference) -> None:
        """Let PD or PID follow a reference from the present state on."""
        gravity = self._checked_gravity()
        state = self.state
        goal = Goal(reference.begin(state.position), state.t)
        limit = self.spec.actuation.torque_limit
        controller = (
            PD(reference, self._gains, gravity) if kind == "pd" else PID(reference, self._gains, limit, gravity)
        )
        self._switch(kind, controller, goal)

    def _checked_gravity(self) -> Gravity:
        self._gravity.check(self.state)
        return self._gravity

    def _target(self, state: HandState) -> Vector | None:
        return None if self._goal is None else self._goal.path(state.t - self._goal.began).position

    def _arrived(self, sample: Sample, goal: Goal | None) -> bool:
        if goal is None:
            return True
        over = goal.began + getattr(goal.path, "seconds", 0.0) + self._rig.backend.period
        late = sample.state.t - over
        off = np.abs(goal.path(sample.state.t - goal.began).position - sample.state.position).max()
        return late >= 0.5 or (late >= 0.0 and off < 0.02 and np.abs(sample.state.velocity).max() < 0.05)

    def _posture(self, posture: Posture) -> Vector:
        values = load_posture(posture, self.spec) if isinstance(posture, str) else self.spec.posture(posture)
        lower, upper = self.limits
        outside = np.maximum(lower - values, values - upper)
        worst = int(np.argmax(outside))
        if outside[worst] > 1e-9:
            raise ConfigError(
                f"posture: {self.spec.aliases[worst]} = {values[worst]:.4f} rad is {outside[worst]:.4f} rad inside the "
                f"margin of its limits [{lower[worst]:.4f}, {upper[worst]:.4f}]; set_margin or use_margin change it"
            )
        return values
