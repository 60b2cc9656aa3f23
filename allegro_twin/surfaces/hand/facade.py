"""`Hand`, the facade for people at a prompt: everything the hand can do, on any backend."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from functools import cached_property
from types import TracebackType
from typing import TYPE_CHECKING, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.app import Rig, assemble
from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.app.controller_settings import PositionSettings
from allegro_twin.control.controllers import Gains
from allegro_twin.control.demonstration import TaughtMotion
from allegro_twin.control.trajectory import KnownPath, Moves, Profile, Waypoint
from allegro_twin.errors import LinkError, MotionStalled
from allegro_twin.files.first_error import closing_noted
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import load_posture, load_trajectory
from allegro_twin.kinematics.pose import Pose
from allegro_twin.sim.contact.collision_free_paths import NEARLY
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.hand.bounds import JointBounds
from allegro_twin.surfaces.hand.cartesian import straight_line_motion
from allegro_twin.surfaces.hand.demonstration import Demonstration
from allegro_twin.surfaces.hand.grasps import GraspOutcome, begin, chosen, grasp_outcome
from allegro_twin.surfaces.hand.live_control import LiveControl
from allegro_twin.surfaces.hand.motion import FirstController, Kind, MotionControl, MotionRequest
from allegro_twin.types import HandState, Sample, Vector, frozen

if TYPE_CHECKING:
    from allegro_twin.sim.engine.backend import SimBackend
    from allegro_twin.twin.mirror.mirror import Mirror

Posture: TypeAlias = str | ArrayLike
"""A name in the library, or joint positions, shape (n,), rad."""


class Hand:
    """A hand to work with. It opens limp, and every way out of `with` leaves it limp.

    In a simulation and a replay time passes only in calls that wait, so a script repeats itself bit for bit; with
    `background=True` it passes on its own in real time, as it always does for a hand on a real bus."""

    def __init__(
        self, rig: Rig, gains: Gains, *, background: bool = False, first: FirstController | None = None
    ) -> None:
        """`first`: what drives it from the first period on, in place of nothing."""
        self._rig, self._bounds, self._closing = rig, JointBounds(rig.spec), ExitStack()
        self._mover = MotionControl(rig, gains, background=background or rig.live, first=first)
        self.direct = LiveControl(rig, self._mover, self._bounds)
        """For a person who drives the hand live: a stop, steering, other gains."""

    @classmethod
    def open(cls, config: str | pathlib.Path | RunConfig, *, background: bool = False) -> Self:
        """Open the hand that a config describes; its `controller` block names the gains, and the gravity where
        it has one. Raises HandError."""
        settings = config if isinstance(config, RunConfig) else load_config(config)
        with ExitStack() as opened:
            rig = assemble(settings)
            opened.callback(rig.backend.close)
            controller = settings.controller
            name = controller.gains if isinstance(controller, PositionSettings) else "default"
            hand = cls(rig, load_gains(name, rig.spec), background=background)
            opened.pop_all()
        return hand

    def __enter__(self) -> Self:
        self._closing.enter_context(closing_noted(self))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing.__exit__(kind, error, trace)

    def close(self) -> None:
        """Leave the hand limp and let go of it. Idempotent. Raises LinkError when the hand did not confirm it: what
        ended the session, if anything did, which says that too; and where a listener does not return."""
        self._mover.driver.close()
        if unconfirmed := self._rig.device.unconfirmed:
            ended = self._mover.driver.error
            raise ended if ended is not None and unconfirmed in str(ended) else LinkError(unconfirmed)

    @property
    def spec(self) -> HandSpec:
        return self._rig.spec

    @property
    def sim(self) -> SimBackend | None:
        """The simulation, where the hand is one: its scene, and `push` from outside."""
        return self._rig.sim

    @cached_property
    def mirror(self) -> Mirror:
        """The model that runs beside a hand from the first time that one asks: `external_torque`, `contacts`, `fault`;
        docs/explanation/mirror.md. Raises ConfigError for a simulated hand, and for one that does not say what its
        torques are."""
        from allegro_twin.twin.mirror.on_rig import mirror_rig  # It needs SciPy, which a hand alone does not.

        return mirror_rig(self._rig, self.listen)

    @property
    def state(self) -> HandState:
        """The newest state."""
        return self._mover.state

    @property
    def controllers(self) -> tuple[Kind, ...]:
        """What `set_controller` takes."""
        return self._mover.kinds

    @property
    def controller(self) -> str:
        """What drives the hand now: one of `controllers`, or the kind of a grasp."""
        return self._mover.kind

    def set_controller(self, kind: Kind, *, torque: ArrayLike = 0.0) -> None:
        """Change the controller while the hand runs, without a jump of torque. `pd` and `pid` stay where the hand is;
        `torque` (N·m, one value or n) is for the torque controller. Raises ConfigError."""
        self._mover.turn_to(kind, self.spec.vector(torque, "torque"))

    @property
    def errors(self) -> Vector:
        """Where the joints should be less where they are, (n,), rad; NaN where the controller wants no position."""
        goal, state = self._mover.goal, self.state
        return frozen(np.full(self.spec.n_joints, np.nan) if goal is None else goal.at(state.t) - state.position)

    @property
    def gravity(self) -> Vector:
        """The gravity that controllers compensate, palm frame, (3,), m/s²."""
        return self.state.gravity if (given := self._mover.given_gravity()) is None else given

    @gravity.setter
    def gravity(self, vector: ArrayLike | None) -> None:
        """Set it where the hand reports none or is wrong about it; None: what the hand reports."""
        self._mover.set_gravity(vector)

    @property
    def limits(self) -> tuple[Vector, Vector]:
        """Lowest and highest joint positions that motions may ask for, margin included, (n,) each, rad."""
        return self._bounds.limits

    @property
    def clipped(self) -> int:
        """How many set-points lay beyond the limits by no more than a joint gives at its stop, `hand.GIVE`, and were
        clipped to them: as of a program that sends back what it has read. What lies further beyond is refused."""
        return self._bounds.clipped

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
        """Go to a posture: the joint that travels furthest peaks at `speed` (rad/s), all arrive together; finger by
        finger where they would meet on the way. From torque or gravity compensation the hand changes to PID. Raises
        ConfigError before anything moves, also for a joint that `limits.velocity` would stop, SelfCollision among them;
        MotionStalled, at once or to whoever waits; MotionInterrupted when another thread stops it, or asks for
        something else, before its end."""
        self._go(posture, speed, profile, wait)

    def fingertips(self) -> dict[str, Pose]:
        """Position (m) and rotation of every fingertip in the palm frame."""
        return self._mover.model.fingertips(self.state.position)

    def move_fingertips(
        self,
        targets: Mapping[str, ArrayLike],
        speed: float = 0.05,
        *,
        euler: Mapping[str, ArrayLike] | None = None,
        wait: bool = True,
    ) -> None:
        """Move fingertips (centres of their spheres) straight to positions in the palm frame, (3,) each, m, and turn
        those of `euler` to roll, pitch, yaw, (3,), rad; the one that travels furthest peaks at `speed`, m/s. Raises as
        `move_to` does."""
        mover, what = self._mover, f"fingertip of {' and '.join(targets)}"
        request = mover.request(what)
        start = np.clip(self.state.position, self.spec.lower, self.spec.upper)
        moves = straight_line_motion(mover.model, start, targets, speed, euler)
        self._rig.check_speed(moves.begin(start).peak, what)
        rows = [self._posture(waypoint.posture, what) for waypoint in moves.waypoints]
        mover.paths.check_line(np.array([start, *rows]), what)
        mover.follow(mover.position_kind, moves, what, request)
        if wait:
            mover.wait(request=request)

    def grasp(
        self, name: str, object_width: float | None = None, force: float | None = None, *, wait: bool = True,
        by_mirror: bool = False,
    ) -> GraspOutcome:  # fmt: skip
        """Perform a grasp of the library: pre-shape, close, squeeze. `object_width` (m) closes a position grasp to
        that size; `force` is N on the thumb of a centroid grasp, or the scale of an envelop grasp; `by_mirror`: that a
        finger has met the object a centroid grasp learns from `mirror`, not from torque and stillness. Returns what the
        hand feels at its end, or, without waiting, now; with a width also whether nothing as wide is there. Raises as
        `move_to`, but what stops it once it closes."""
        mover, stored = self._mover, chosen(name, object_width, self._mover.model, self.spec)
        request = mover.request(f"grasp {name}")
        for posture in (stored.preshape, stored.close, stored.squeeze):
            self._bounds.check(posture)
        begin(stored, mover, self.spec, self.limits, force, request, self.mirror if by_mirror else None)
        if wait:
            mover.wait(request=request)
        now = self.state
        weight = mover.model.gravity_torque(now.position, self.gravity)
        met = mover.paths.touching(now.position, NEARLY)
        return grasp_outcome(stored, now, mover.model, self.spec, weight, object_width is not None, met)

    def wait(self, seconds: float | None = None) -> HandState:
        """Let time pass: so many seconds of the hand's clock, or until the motion is over and the joints have settled
        (0.02 rad, or half a second at most). Raises MotionStalled, once, for a motion that met something;
        MotionInterrupted when it is stopped, or another is asked for, while this waits for its end."""
        return self._mover.wait(seconds)

    @property
    def stalled(self) -> MotionStalled | None:
        """What stopped the last motion, if anything did."""
        return self._mover.stalled

    def stop(self) -> None:
        """Stay here: PID at the present position, or the firmware's own loop. Any thread may call it; a call that waits
        for a motion then raises MotionInterrupted."""
        self._mover.hold(self._mover.still_kind)

    @contextmanager
    def teach(self) -> Iterator[Demonstration]:
        """Gravity compensation while somebody moves the fingers, or none where the hand takes no torques; what they
        show is kept. Afterwards the hand holds where it was left."""
        demonstration = Demonstration(self.spec)
        self.set_controller("gravity" if "gravity" in self.controllers else "limp")
        with self.listening(demonstration):
            yield demonstration
        self.stop()

    def play(self, motion: str | TaughtMotion, speed: float = 1.0, *, approach: float = 1.0, wait: bool = True) -> None:
        """Go to where a motion begins (peak speed `approach`, rad/s), then repeat it `speed` times as fast as it was
        shown: one of the library's trajectories, or what a demonstration gave. Raises as `move_to` does."""
        if isinstance(motion, str):
            motion = load_trajectory(motion, self.spec)
        what = motion.name or "the motion"
        motion = replace(motion, positions=np.array([self._posture(row, what) for row in motion.positions]))
        path, mover = motion.path(speed), self._mover
        self._rig.check_speed(path.peak, what)
        request = self._go(motion.positions[0], approach, "minimum_jerk", True)
        mover.follow(mover.still_kind, KnownPath(path), what, request)
        if wait:
            mover.wait(request=request)

    def listen(self, listener: Callable[[Sample], None]) -> None:
        """Call somebody with every sample from now on."""
        self._mover.listeners.append(listener)

    def listening(self, listener: Callable[[Sample], None]) -> AbstractContextManager[None]:
        """Call somebody with every sample for a while: a plot, a scripted guide."""
        return self._mover.listening(listener)

    def _go(self, posture: Posture, speed: float, profile: Profile, wait: bool) -> MotionRequest:
        mover, what = self._mover, posture if isinstance(posture, str) else "the posture"
        goal, request = Waypoint(self._posture(posture), speed=speed, profile=profile), mover.request(what)
        legs = mover.planned(lambda start: mover.paths.legs(start, goal, self.limits, what), request)
        mover.follow(mover.position_kind, Moves(legs), what, request)
        if wait:
            mover.wait(request=request)
        return request

    def _posture(self, posture: Posture, what: str = "the posture") -> Vector:
        if isinstance(posture, str):
            return self._bounds.check(load_posture(posture, self.spec), posture)
        return self._bounds.admit(posture, what)
