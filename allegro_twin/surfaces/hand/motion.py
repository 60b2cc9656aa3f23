"""Motion of a hand: its controllers, the motions that they follow, and what becomes of them."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.app import Rig
from allegro_twin.backend import limp_of
from allegro_twin.control.bumpless_switch import BumplessSwitch
from allegro_twin.control.controllers import (
    PD,
    PID,
    ConstantCommand,
    ConstantTorque,
    Gains,
    GravityCompensation,
    GravityFeedforward,
    PositionControl,
)
from allegro_twin.control.motion_feedforward import MotionFeedforward
from allegro_twin.control.setpoint_filter import SmoothSetpoint
from allegro_twin.control.trajectory import Hold, KnownPath, Path, Reference, number
from allegro_twin.errors import CommandError, ConfigError, MotionInterrupted, MotionStalled, unknown
from allegro_twin.files.schema import check_gravity
from allegro_twin.kinematics.hand import HandKinematics, hand_kinematics
from allegro_twin.kinematics.orientation import STANDARD_GRAVITY
from allegro_twin.loop import paced, run
from allegro_twin.plugins import member_of, unwrapped
from allegro_twin.sim.contact.collision_free_paths import CollisionFreePaths
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.hand.loop_thread import LoopThread
from allegro_twin.types import HandState, Sample, TorqueCommand, Vector, frozen

_SETTLED, _STILL, _PATIENCE = 0.02, 0.05, 0.5  # rad, rad/s, s.
_SHORT = 0.03  # rad. A joint further from where it should be is not there.
_MOVED, _STUCK = 0.01, 0.5  # rad, s. A joint that should move and has not moved so far in that time is stuck.
_SAG = 1.5  # Of what a servo gives way under the hand's own weight: what is further away has met something.
_FULL = 0.99  # Of its clip: a joint that is given so much should move.
_LATEST = 3.0  # s after the end. What shakes in a contact instead of coming to rest is stuck as well.


class Goal(NamedTuple):
    """Goal of the joints: a path, when it began and for how long it lasts, s."""

    path: Path
    began: float
    seconds: float
    what: str = "the motion"
    """For messages."""
    pressing: float = 0.0
    """From when on it may press, s since it began: being stopped is then what it is for."""

    def at(self, t: float) -> Vector:
        """Where the joints should be, (n,), rad."""
        return self.path(max(t - self.began, 0.0)).position


class MotionMonitor:
    """Follows a motion sample by sample until it has arrived or is stuck."""

    def __init__(self, goal: Goal, spec: HandSpec, gains: Gains, sag: Vector | float = 0.0) -> None:
        """`sag`: how far the hand's own weight may keep a soft servo from its set-point, (n,), rad."""
        self.goal, self.arrived = goal, False
        self.interrupted = ""
        """What ended it before it had arrived, if somebody did; for messages."""
        self.successor: MotionMonitor | None = None
        """Monitor that follows a motion whose goal was moved, since then."""
        self._spec, self._over = spec, goal.began + goal.seconds
        # What dry friction and weight alone keep from its place is not stuck.
        friction = 2.0 * spec.actuation.frictionloss / np.maximum(gains.kp, 1e-9)
        self._short = np.maximum(_SHORT, friction + _SAG * sag)
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
    def text(self) -> str:
        """What is stuck, the furthest from its place first."""
        worst = sorted(self._stuck.items(), key=lambda item: -item[1])
        rest = f" and {len(worst) - 3} more" if len(worst) > 3 else ""
        return ", ".join(f"{name} {short:.2f} rad" for name, short in worst[:3]) + rest


def servo_sag(spec: HandSpec, model: HandKinematics) -> Vector:
    """How far the weight of its fingers may bend each servo, however the palm is turned, (n,), rad: the more of the
    flat hand and of the middle of all ranges. 0 for a hand that takes torques, whose controllers carry the weight."""
    if "torque" in spec.commands or spec.actuation.stiffness is None:
        return np.zeros(spec.n_joints)
    postures = (np.asarray(spec.rest), (spec.lower + spec.upper) / 2.0)
    weights = [model.gravity_torque(np.tile(each, (3, 1)), STANDARD_GRAVITY * np.eye(3)) for each in postures]
    return np.asarray(np.linalg.norm(weights, axis=1).max(axis=0) / spec.actuation.stiffness)


def _settled(error: Vector, state: HandState) -> bool:
    return bool(np.abs(error).max() < _SETTLED and np.abs(state.velocity).max() < _STILL)


Kind: TypeAlias = Literal["torque", "gravity", "pd", "pid", "limp", "position"]
KINDS: tuple[Kind, ...] = ("torque", "gravity", "pd", "pid")
"""Controllers of a hand that takes torques."""
FIRMWARES: tuple[Kind, ...] = ("limp", "position")
"""Controllers of a hand whose firmware closes the loop."""
T = TypeVar("T")


class FirstController(NamedTuple):
    """Controller that drives a hand from its first period on, and its name."""

    kind: str
    controller: Any


@dataclass(slots=True, eq=False)
class MotionRequest:
    """One motion that somebody asks for, from when its planning begins: what else drives the hand since ends it."""

    what: str
    """For messages."""
    turn: int
    """`MotionControl` counts what drives the hand; this is the count that the request goes on from."""
    watch: MotionMonitor | None = None
    """What follows its motion, once that has begun."""


_DRIFT = 0.02  # rad. A hand that moved on by more while its way was sought needs another way.


class MotionControl:
    """Turns wishes into controllers and hands the hand over to them, watches what they do, and waits for it."""

    def __init__(self, rig: Rig, gains: Gains, *, background: bool, first: FirstController | None = None) -> None:
        self._rig, self.gains = rig, gains
        self.model, self.paths = hand_kinematics(rig.spec), CollisionFreePaths(rig.spec, rig.check_speed)
        self.kinds = KINDS if "torque" in rig.spec.commands else FIRMWARES
        """The controllers that this hand can have: the first lets go of it."""
        self.kind: Kind | str = self.kinds[0] if first is None else first.kind
        self.listeners: list[Callable[[Sample], None]] = []
        self.stalled: MotionStalled | None = None
        """What stopped the last motion, if anything did."""
        self._told, self._changing, self._cut = True, threading.Lock(), False
        self._turn, self._last = 0, ""  # How often something else began to drive the hand, and what that did.
        self._watch: MotionMonitor | None = None
        self._sag = servo_sag(rig.spec, self.model)
        motion, gravity = (member_of(unwrapped(rig.controller), name) for name in ("motion", "gravity"))
        vector = gravity.vector if isinstance(gravity, GravityFeedforward) else None
        self._gravity = GravityFeedforward(self.model.gravity_torque, vector)
        self._motion = motion if isinstance(motion, MotionFeedforward) else None  # As the controller asks.
        self._limp = ConstantCommand(limp_of(rig.spec))
        self._relay = BumplessSwitch(self._limp if first is None else first.controller, rig.spec.actuation.torque_limit)
        self.check_speed = rig.check_speed
        self.driver = LoopThread(self._samples(background), background=background, release=rig.backend.close)

    @property
    def state(self) -> HandState:
        return self.driver.latest.state

    @property
    def soon(self) -> float:
        """When a controller begins that is handed over now: at the next state, s."""
        return self.state.t + self._rig.backend.period

    @property
    def goal(self) -> Goal | None:
        """What the joints are asked to do."""
        return None if self._watch is None else self._watch.goal

    @property
    def position_kind(self) -> Kind:
        """The controller that a motion takes: the firmware's own, PD if it drives already, else PID."""
        if self.kinds is FIRMWARES:
            return "position"
        return "pd" if self.kind == "pd" else "pid"

    @property
    def still_kind(self) -> Kind:
        """The controller that holds the hand where it is, and repeats what it was shown."""
        return "position" if self.kinds is FIRMWARES else "pid"

    @property
    def gravity(self) -> GravityFeedforward:
        """The feed-forward. Raises ConfigError when nobody says where down is."""
        self._gravity.check(self.state)
        return self._gravity

    def set_gravity(self, vector: ArrayLike | None) -> None:
        """Compensate this gravity from now on, or what the hand reports for None. Raises ConfigError."""
        if vector is not None:
            given = vector
            try:
                vector = frozen(given)
            except (TypeError, ValueError, OverflowError):
                vector = np.full(3, np.nan)  # Refused below.
            if vector.shape != (3,) or not np.isfinite(vector).all():
                raise ConfigError(f"gravity needs three finite numbers in the palm frame, m/s²; not {given!r}")
            try:
                check_gravity((float(vector[0]), float(vector[1]), float(vector[2])))
            except ValueError as error:
                raise ConfigError(str(error)) from error
        self._gravity = GravityFeedforward(self.model.gravity_torque, vector)
        self._relay.amend(lambda c: replace(c, gravity=self._gravity) if getattr(c, "gravity", None) is not None else c)

    def given_gravity(self) -> Vector | None:
        return self._gravity.vector

    def request(self, what: str) -> MotionRequest:
        """Begin to ask for a motion; `what` it is stands in messages."""
        return MotionRequest(what, self._turn)

    def drive(
        self,
        kind: Kind | str,
        controller: Any,
        goal: Goal | None = None,
        request: MotionRequest | None = None,
        did: str = "",
    ) -> None:
        """Hand over to a controller; `goal` says what its motion is, for those who wait, `did` what that does to the
        motion before it. Raises CommandError while the hand is cut off, MotionInterrupted for a request that something
        else has overtaken."""
        name = f"the controller {kind}" if goal is None else goal.what
        with self._changing:
            if self._cut:
                raise CommandError("the hand was stopped and is limp: release the stop first")
            if request is not None and request.turn != self._turn:
                raise MotionInterrupted(f"{request.what} {self._last} before it began")
            self._interrupt(did or f"was replaced by {name}")
            self.kind, self.stalled, self._watch = kind, None, self._watched(goal)
            self._relay.switch(controller)
            if request is not None:
                request.turn, request.watch = self._turn, self._watch

    def _interrupt(self, did: str) -> None:
        self._turn, self._last = self._turn + 1, did
        if self._watch is not None and not self._watch.arrived:
            self._watch.interrupted = did

    def turn_to(self, kind: Kind, torque: Vector) -> None:
        """Another controller: the torques, (n,), N·m; gravity compensation; or stay here. Raises ConfigError."""
        if kind not in self.kinds:
            raise ConfigError(unknown("controller", kind, self.kinds))
        if kind == "torque":
            self.drive("torque", ConstantTorque(torque))
        elif kind == "limp":
            self.drive("limp", self._limp)
        elif kind == "gravity":
            self.drive("gravity", GravityCompensation(self.gravity))
        else:
            self.hold(kind, f"was replaced by the controller {kind}")

    @property
    def cut(self) -> bool:
        """Whether the hand is limp and takes no wish, one that is being planned among them."""
        return self._cut

    @cut.setter
    def cut(self, on: bool) -> None:
        with self._changing:
            self._cut = on
            if on:
                self._interrupt("was stopped, and the hand is limp,")
                self.kind, self.stalled, self._watch = self.kinds[0], None, None
                self._relay.cut(self._limp)

    def steer(self, posture: Vector, speed: float, what: str) -> None:
        """Head for a posture, (n,), rad, at `speed`, rad/s, from whatever the last such wish is doing, or from rest."""
        watch = self._watch
        if watch is None or not isinstance(watch.goal.path, SmoothSetpoint):
            self.follow(self.position_kind, KnownPath(SmoothSetpoint(self.state.position)), what)
            watch = self._watch
        with self._changing:
            if self._cut or watch is None or watch is not self._watch:
                return  # Somebody wanted something else in the meantime.
            path, began = watch.goal.path, watch.goal.began
            assert isinstance(path, SmoothSetpoint)
            seconds = path.head_for(max(self.state.t - began, 0.0), posture, speed)
            self._watch = watch.successor = self._watched(Goal(path, began, seconds, what))

    def hold(self, kind: Kind, did: str = "was stopped", request: MotionRequest | None = None) -> None:
        """Stay where the hand is; `did`: what that does to the motion before, for messages."""
        self.follow(kind, Hold(self.state.position), "the stop", request, did)

    def follow(
        self,
        kind: Kind,
        reference: Reference,
        what: str = "the motion",
        request: MotionRequest | None = None,
        did: str = "",
    ) -> None:
        """Let PD or PID follow a reference from the present state on; `what` it is stands in messages."""
        controller, state = self._position(kind, reference), self.state
        path = reference.begin(state.position)
        seconds = float(getattr(path, "seconds", 0.0))
        goal = Goal(path, self.soon, seconds, what, math.inf if seconds else 0.0)
        self.drive(kind, controller, goal, request, did)

    def planned(self, plan: Callable[[Vector], T], request: MotionRequest) -> T:
        """What is planned from where the joints are, (n,), rad. A hand that moved on meanwhile stops first."""
        start = self.state.position
        found = plan(start)
        if np.abs(self.state.position - start).max() <= _DRIFT:
            return found
        self.hold(self.position_kind, request=request)
        return plan(self.wait(request=request).position)

    def wait(self, seconds: float | None = None, *, request: MotionRequest | None = None) -> HandState:
        """For a time, s, or until the motion, that of the request or the present one, is over and the joints have
        settled. Raises MotionStalled if it was stopped and nobody was told yet; MotionInterrupted if something else
        drives the hand before its end; ConfigError for a time that never ends."""
        if seconds is not None and not 0.0 <= (seconds := number(seconds, "a time to wait")) < math.inf:
            raise ConfigError(f"a time to wait is finite and not negative, s; not {seconds}")
        watch, end = self._watch if request is None else request.watch, None
        if seconds is not None:
            watch, end = None, self.state.t + seconds - 1e-9

        def over(sample: Sample) -> bool:
            nonlocal watch
            if end is not None:
                return sample.state.t >= end
            while watch is not None and watch.successor is not None:
                watch = watch.successor
            return watch is None or watch.arrived or self._watch is not watch

        state = self.driver.wait(over).state
        if watch is not None and watch.interrupted:
            what = watch.goal.what if request is None else request.what
            raise MotionInterrupted(f"{what} {watch.interrupted} before its end")
        if self.stalled is not None and not self._told:
            self._told = True
            raise self.stalled
        return state

    def _position(self, kind: Kind, reference: Reference) -> PD | PID | PositionControl:
        if kind == "position":
            return PositionControl(reference)
        if kind == "pd":
            return PD(reference, self.gains, self.gravity, self._motion)
        return PID(reference, self.gains, self._rig.spec.actuation.torque_limit, self.gravity, self._motion)

    def _watched(self, goal: Goal | None) -> MotionMonitor | None:
        if goal is None:
            return None
        return MotionMonitor(goal, self._rig.spec, self.gains, self._sag)

    def _look(self, sample: Sample) -> None:
        """Follow the motion; one that is stuck is given up where the joints are, and its torque with it."""
        watch, state = self._watch, sample.state
        if watch is None or not watch(sample):
            return
        parts = " and ".join(dict.fromkeys(part for pair in self.paths.touching(state.position) for part in pair))
        met = f"{parts} touch" if parts else "something is in the way"
        hold = Hold(state.position)
        with self._changing:
            if self._watch is not watch:
                return  # Somebody wanted something else in the meantime.
            self._relay.switch(self._position(self.still_kind, hold))
            words = f"{watch.goal.what} stalled: {watch.text} short; {met}. The hand holds where it is"
            self.kind, self.stalled, self._told = self.still_kind, MotionStalled(words), False
            self._watch = self._watched(Goal(hold.begin(state.position), state.t, 0.0))

    def _samples(self, background: bool) -> Iterator[Sample]:
        samples = run(self._rig.backend, self._relay)
        for sample in paced(samples) if background and not self._rig.live else samples:
            self._look(sample)
            for listener in tuple(self.listeners):
                listener(sample)
            yield sample

    @contextmanager
    def listening(self, listener: Callable[[Sample], None]) -> Iterator[None]:
        """Call somebody with every sample for a while."""
        self.listeners.append(listener)
        try:
            yield
        finally:
            self.listeners.remove(listener)
