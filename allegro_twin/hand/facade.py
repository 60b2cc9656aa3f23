"""`Hand`, the facade for people at a prompt: everything the hand can do, on any backend."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
from typing import TYPE_CHECKING, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.build import Rig, assemble
from allegro_twin.config import PositionSettings, RunConfig, load_config
from allegro_twin.control.controllers import Gains
from allegro_twin.control.teach import Taught
from allegro_twin.control.trajectory import Following, Moves, Profile, Waypoint
from allegro_twin.errors import ConfigError, LinkError, unknown
from allegro_twin.grasping import performer
from allegro_twin.hand.bounds import Bounds
from allegro_twin.hand.cartesian import straight
from allegro_twin.hand.grasps import Grasped, felt, for_width, timed
from allegro_twin.hand.lesson import Lesson
from allegro_twin.hand.mover import KINDS, Goal, Kind, Mover
from allegro_twin.kinematics.model import Pose
from allegro_twin.library.gains import load_gains
from allegro_twin.library.named import load_grasp, load_posture
from allegro_twin.spec import HandSpec
from allegro_twin.types import HandState, Sample, Vector, frozen

if TYPE_CHECKING:
    from allegro_twin.sim.backend import SimBackend

Posture: TypeAlias = str | ArrayLike
"""A name in the library, or joint positions, shape (n,), rad."""


class Hand:
    """A hand to work with.

    It opens limp. In a simulation and a replay time passes only in calls that wait, so a script repeats itself bit for
    bit; with `background=True` it passes on its own in real time, as it always does for a hand on a real bus. Every way
    out of `with` leaves the hand limp.
    """

    def __init__(self, rig: Rig, gains: Gains, *, background: bool = False) -> None:
        self._rig, self._bounds = rig, Bounds(rig.spec)
        self._mover = Mover(rig, gains, background=background or rig.live)

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
        """Leave the hand limp and let go of it. Idempotent. Raises LinkError when the hand did not confirm it."""
        self._mover.driver.close()
        self._rig.backend.close()
        if self._rig.wire is not None and self._rig.wire.unconfirmed:
            raise LinkError(self._rig.wire.unconfirmed)

    @property
    def spec(self) -> HandSpec:
        return self._rig.spec

    @property
    def sim(self) -> SimBackend | None:
        """The simulation, where the hand is one: its scene, and `push` from outside."""
        return self._rig.sim

    @property
    def state(self) -> HandState:
        """The newest state."""
        return self._mover.state

    @property
    def controllers(self) -> tuple[Kind, ...]:
        """What `set_controller` takes."""
        return KINDS

    @property
    def controller(self) -> str:
        """What drives the hand now: one of `controllers`, or the kind of a grasp."""
        return self._mover.kind

    def set_controller(self, kind: Kind, *, torque: ArrayLike = 0.0) -> None:
        """Change the controller while the hand runs, without a jump of torque. `pd` and `pid` stay where the hand is;
        `torque` (N·m, one value or n) is for the torque controller. Raises ConfigError."""
        if kind not in KINDS:
            raise ConfigError(unknown("controller", kind, KINDS))
        if kind == "torque":
            self._mover.limp(self.spec.vector(torque, "torque"))
        elif kind == "gravity":
            self._mover.compensate()
        else:
            self._mover.hold(kind)

    @property
    def errors(self) -> Vector:
        """Where the joints should be less where they are, (n,), rad; NaN where the controller wants no position."""
        goal, state = self._mover.goal, self.state
        return frozen(np.full(self.spec.n_joints, np.nan) if goal is None else goal.at(state.t) - state.position)

    @property
    def gravity(self) -> Vector:
        """The gravity that controllers compensate, palm frame, (3,), m/s²."""
        given = self._mover.given_gravity()
        return self.state.gravity if given is None else given

    @gravity.setter
    def gravity(self, vector: ArrayLike | None) -> None:
        """Set it where the hand reports none or is wrong about it; None: what the hand reports."""
        if vector is not None:
            vector = frozen(vector)
            if vector.shape != (3,) or not np.isfinite(vector).all():
                raise ConfigError(f"gravity needs three finite numbers in the palm frame, m/s²; not {vector}")
        self._mover.set_gravity(vector)

    @property
    def limits(self) -> tuple[Vector, Vector]:
        """Lowest and highest joint positions that motions may ask for, margin included, (n,) each, rad."""
        return self._bounds.limits

    def set_margin(
        self, general: float | None = None, *, percent: float | None = None, per_joint: ArrayLike | None = None
    ) -> None:
        """Stay away from the joint limits: by one distance (rad), a percentage of each joint's range, or n distances;
        `use_margin` turns it on and off. Raises ConfigError unless one is given and leaves every joint a range."""
        self._bounds.set_margin(general, percent, per_joint)

    @property
    def use_margin(self) -> bool:
        """Whether motions keep the margin."""
        return self._bounds.use_margin

    @use_margin.setter
    def use_margin(self, on: bool) -> None:
        self._bounds.use_margin = on

    def move_to(
        self, posture: Posture, speed: float = 1.0, *, profile: Profile = "minimum_jerk", wait: bool = True
    ) -> None:
        """Go to a posture: the joint that travels furthest peaks at `speed` (rad/s), all arrive together. From torque
        or gravity compensation the hand changes to PID. Raises ConfigError before anything moves."""
        moves = Moves([Waypoint(self._posture(posture), speed=speed, profile=profile)])
        moves.begin(self.state.position)  # A wrong speed is an error here, not in the loop.
        self._mover.follow("pd" if self._mover.kind == "pd" else "pid", moves)
        if wait:
            self.wait()

    def fingertips(self) -> dict[str, Pose]:
        """Position (m) and rotation of every fingertip in the palm frame."""
        return self._mover.model.fingertips(self.state.position)

    def move_fingertips(self, targets: Mapping[str, ArrayLike], speed: float = 0.05, *, wait: bool = True) -> None:
        """Move fingertips (centres of their spheres) straight to positions in the palm frame, (3,) each, m; the one
        that travels furthest peaks at `speed`, m/s. Raises ConfigError before anything moves."""
        moves = straight(self.spec, self.state.position, targets, speed)
        for waypoint in moves.waypoints:
            self._bounds.check(self.spec.posture(waypoint.posture))
        self._mover.follow("pd" if self._mover.kind == "pd" else "pid", moves)
        if wait:
            self.wait()

    def grasp(
        self, name: str, object_width: float | None = None, force: float | None = None, *, wait: bool = True
    ) -> Grasped:
        """Perform a grasp of the library: pre-shape, close, squeeze. `object_width` (m) closes a position grasp to
        that size; `force` is N on the thumb of a centroid grasp, or the scale of an envelop grasp. What the hand felt
        at its end, or, without waiting, feels now. Raises ConfigError before anything moves."""
        mover, spec = self._mover, self.spec
        stored = load_grasp(name, spec)
        if object_width is not None:
            stored = for_width(stored, object_width, mover.model, spec)
        for posture in (stored.preshape, stored.close, stored.squeeze):
            self._bounds.check(posture)
        start = self.state
        motion = timed(stored, start.position)
        controller = performer(stored, motion, spec, mover.gains, mover.gravity, mover.model, force=force)
        path = motion.moves.begin(start.position)
        mover.drive(f"grasp {name}", controller, Goal(path, start.t, path.seconds))
        if wait:
            self.wait()
        now = self.state
        return felt(stored, now, mover.model, spec, mover.model.gravity_torque(now.position, self.gravity))

    def wait(self, seconds: float | None = None) -> HandState:
        """Let time pass: so many seconds of the hand's clock, or until the motion is over and the joints have settled
        (0.02 rad, or half a second at most)."""
        if seconds is None:
            return self._mover.wait()
        end = self.state.t + seconds
        return self._mover.driver.wait(lambda sample: sample.state.t >= end - 1e-9).state

    def stop(self) -> None:
        """Stay here: PID at the present position."""
        self._mover.hold("pid")

    @contextmanager
    def teach(self) -> Iterator[Lesson]:
        """Gravity compensation while somebody moves the fingers; what happens is kept in the lesson. Afterwards the
        hand holds where it was left."""
        lesson = Lesson(self.spec)
        self.set_controller("gravity")
        with self.listening(lesson):
            yield lesson
        self.stop()

    def play(self, motion: Taught, speed: float = 1.0, *, approach: float = 1.0, wait: bool = True) -> None:
        """Go to where a taught motion begins (peak speed `approach`, rad/s), then repeat it `speed` times as fast."""
        path = motion.path(speed)
        for row in motion.positions:
            self._posture(row)
        self.move_to(motion.positions[0], approach)
        self._mover.follow("pid", Following(path))
        if wait:
            self.wait()

    def listen(self, listener: Callable[[Sample], None]) -> None:
        """Call somebody with every sample from now on."""
        self._mover.listeners.append(listener)

    @contextmanager
    def listening(self, listener: Callable[[Sample], None]) -> Iterator[None]:
        """Call somebody with every sample for a while: a plot, a scripted guide."""
        self.listen(listener)
        try:
            yield
        finally:
            self._mover.listeners.remove(listener)

    def _posture(self, posture: Posture) -> Vector:
        values = load_posture(posture, self.spec) if isinstance(posture, str) else self.spec.posture(posture)
        return self._bounds.check(values)
