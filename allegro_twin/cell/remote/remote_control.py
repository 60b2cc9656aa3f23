"""The cell led from outside: whoever moves its target or its fingers is obeyed within the fence; nothing decides."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from allegro_twin.cell.arm.target import Smoothing, approached
from allegro_twin.cell.assembly import Room
from allegro_twin.cell.journal.observers import Onlookers
from allegro_twin.cell.motion.arm_motion import Guide
from allegro_twin.cell.remote.workspace_limits import Fence
from allegro_twin.cell.run import law_of
from allegro_twin.control.controllers import PD, GravityFeedforward
from allegro_twin.control.setpoint_filter import SmoothSetpoint
from allegro_twin.control.trajectory import Path, SetPoint, TimedPath
from allegro_twin.errors import CommandError, ConfigError
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.kinematics.pose import Pose
from allegro_twin.loop import paced, run, together
from allegro_twin.types import Array, HandState, Sample, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Palm:
    """Be with the palm at a pose of the world."""

    pose: Pose


@dataclass(frozen=True, slots=True, eq=False)
class Fingers:
    """Go through postures, (k, n), rad, at times from now on, (k,), s; with velocities, (k, n), rad/s, on cubics."""

    times: Vector
    postures: Array
    velocities: Array | None = None


@dataclass(frozen=True, slots=True)
class Stay:
    """Arm and fingers stay where they are."""


Wish: TypeAlias = Palm | Fingers | Stay


class Led:
    """Where arm and fingers are to be. `wish` may be called by any thread; what is wished is looked at, and done, in
    the loop's own."""

    def __init__(self, room: Room) -> None:
        self.room, self.guide = room, Guide(room.posture, room.cell.model)
        self.guide.let_go()
        self._fence = Fence(room)
        self._path: Path = SmoothSetpoint(room.open)
        self._since, self._wishes = 0.0, queue.SimpleQueue[Wish]()
        self._goal, self._at, self._t = room.security, room.security, 0.0
        arm = room.settings.arm
        self._smoothing = Smoothing(arm.speed, arm.turning)

    @property
    def goal(self) -> Pose:
        """Where the palm is to be in the end, in the world."""
        return self._goal

    def wish(self, wish: Wish) -> None:
        """Soon."""
        self._wishes.put(wish)

    def begin(self, position: Vector) -> Path:
        """As a reference of the fingers' controller: what is wished of them now is always their path."""
        return self.fingers

    def fingers(self, t: float) -> SetPoint:
        """Where they are to be at a time, s."""
        return self._path(t - self._since)

    def turn(self, arm: HandState) -> list[str]:
        """Look at what was wished, of several places of the palm in a row only at the last; what was refused, a
        sentence each."""
        refused: list[str] = []
        waiting: list[Wish] = []
        while not self._wishes.empty():
            wish = self._wishes.get()
            if waiting and isinstance(wish, Palm) and isinstance(waiting[-1], Palm):
                waiting.pop()
            waiting.append(wish)
        for wish in waiting:
            try:
                self._do(wish, arm)
            except CommandError as error:
                refused.append(str(error))
        # The palm goes straight and turns about itself; a flange that did would swing it.
        self._at, self._t = approached(self._at, self._goal, arm.t - self._t, self._smoothing), arm.t
        self.guide.target.move(self.room.cell.flange_for(self._at))
        return refused

    def _do(self, wish: Wish, arm: HandState) -> None:
        match wish:
            case Palm(pose):
                self._goal = self._fence.arm(pose, self._at, arm.position, self.fingers(arm.t).position)
            case Fingers(times, postures, velocities):
                path = self._timed(times, postures, velocities, arm.t)
                self._fence.fingers(path, self.room.cell.palm(arm))
                self._path, self._since = path, arm.t
            case Stay():
                self._goal = self._at = self.room.cell.palm(arm)
                self._path, self._since = SmoothSetpoint(self.fingers(arm.t).position), arm.t

    def _timed(self, times: Vector, postures: Array, velocities: Array | None, t: float) -> TimedPath:
        times = np.asarray(times, dtype=np.float64)
        if not len(times) or not np.isfinite(times).all() or times[0] <= 0.0 or (np.diff(times) <= 0.0).any():
            raise CommandError(f"fingers: times must ascend from above 0 s; they are {times[:6].tolist()}")
        here, spec = self.fingers(t).position, self.room.hand.spec
        try:
            postures = np.array([spec.measured_posture(row, "fingers") for row in postures])
        except ConfigError as error:
            raise CommandError(str(error)) from error
        rates = None if velocities is None else np.vstack([np.zeros_like(here), velocities])
        return TimedPath(np.concatenate([[0.0], times]), np.vstack([here, postures]), rates)


def follow(
    led: Led, onlookers: Onlookers, until: Callable[[float], bool] = lambda t: False, speed: float | None = 1.0
) -> None:
    """Turn the cell's loop until that is so at a time, s, at `speed` times real time; None: as fast as it goes.

    Raises HandFault and LinkError, which end it.
    """
    room, spec = led.room, led.room.hand.spec
    onlookers.follows(led.guide, led.fingers)
    law = law_of(room, led.guide)
    grip = PD(led, load_gains(room.settings.hand.gains, spec), GravityFeedforward(room.model.gravity_torque))
    arms: Iterator[Sample] = run(room.arm, law)
    if speed is not None:
        arms = paced(arms, speed)
    hands = onlookers.hand(run(room.hand, grip))
    for which, sample in together((onlookers.arm(arms), room.arm.period), (hands, room.hand.period)):
        if which == 0:
            for sentence in led.turn(sample.state):
                onlookers.refused(sample.state.t, sentence)
            if until(sample.state.t):
                return
