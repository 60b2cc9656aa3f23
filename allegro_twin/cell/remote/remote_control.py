"""The cell remote from outside: whoever moves its target or its fingers is obeyed within the fence; nothing decides."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from allegro_twin.cell.arm.contact_reflex import RETREAT, retreat_offset
from allegro_twin.cell.arm.target import Smoothing, approach
from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.journal.observers import Observers
from allegro_twin.cell.motion.arm_motion import ArmGuide
from allegro_twin.cell.remote.workspace_limits import WorkspaceLimits
from allegro_twin.cell.run import arm_controller, run_through_reflexes
from allegro_twin.control.controllers import PD, GravityFeedforward
from allegro_twin.control.setpoint_filter import SmoothSetpoint
from allegro_twin.control.trajectory import Path, SetPoint, TimedPath
from allegro_twin.errors import ArmReflex, CommandError, ConfigError
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.kinematics.pose import Pose
from allegro_twin.loop import interleave, paced, run
from allegro_twin.types import Array, HandState, Sample, Vector


@dataclass(frozen=True, slots=True, eq=False)
class PalmCommand:
    """Be with the palm at a pose of the world."""

    pose: Pose


@dataclass(frozen=True, slots=True, eq=False)
class FingersCommand:
    """Go through postures, (k, n), rad, at times from now on, (k,), s; with velocities, (k, n), rad/s, on cubics."""

    times: Vector
    postures: Array
    velocities: Array | None = None


@dataclass(frozen=True, slots=True)
class StayCommand:
    """Arm and fingers stay where they are."""


@dataclass(frozen=True, slots=True)
class StopCommand:
    """Arm and fingers stay where they are, whoever commands them, until the stop is released."""


@dataclass(frozen=True, slots=True)
class ReleaseCommand:
    """Commands are obeyed again."""


RemoteCommand: TypeAlias = PalmCommand | FingersCommand | StayCommand | StopCommand | ReleaseCommand


class RemoteControl:
    """Targets of arm and fingers from outside. `command` may be called by any thread; what is wished is looked at, and
    done, in the loop's own, in the order of the calls: nothing that comes after a stop moves, whoever sent it."""

    def __init__(self, cell: Cell) -> None:
        self.cell, self.guide = cell, ArmGuide(cell.posture, cell.robot.model)
        self.guide.let_go()
        self._limits = WorkspaceLimits(cell)
        self._path: Path = SmoothSetpoint(cell.open)
        self._since, self._commands = 0.0, queue.SimpleQueue[RemoteCommand]()
        self._said: list[str] = []
        self._stopped, self._told = False, False
        self._goal, self._at, self._t = cell.security, cell.security, 0.0
        arm = cell.settings.arm
        self._smoothing = Smoothing(arm.speed, arm.turning)

    @property
    def goal(self) -> Pose:
        """Where the palm is to be in the end, in the world."""
        return self._goal

    @property
    def stopped(self) -> bool:
        """Whether a stop has not been released."""
        return self._stopped

    def command(self, command: RemoteCommand) -> None:
        """Soon."""
        self._commands.put(command)

    def begin(self, position: Vector) -> Path:
        """As a reference of the fingers' controller: what is wished of them now is always their path."""
        return self.fingers

    def fingers(self, t: float) -> SetPoint:
        """Where they are to be at a time, s."""
        return self._path(t - self._since)

    def on_reflex(self, error: ArmReflex, arm: HandState) -> None:
        """The arm has stopped by itself and is recovered: its palm backs off and stays there."""
        self._at, self._t = self.cell.robot.palm(arm), arm.t
        if self._stopped:
            self._goal = self._at
            self.guide.target.move(self.cell.robot.flange_for(self._at))
            self._said.append(f"{error}. It is recovered and stays: it is stopped")
            return
        away = retreat_offset(error, self.cell.robot.base.rotation)
        self._goal = Pose(self._at.position + away, self._at.rotation)
        self.guide.target.move(self.cell.robot.flange_for(self._at))
        self._said.append(f"{error}. It is recovered and backs off by {RETREAT:g} m: lead it another way")

    def update(self, arm: HandState) -> list[str]:
        """Look at what was wished, of several places of the palm in a row only at the last; what was refused, a
        sentence each."""
        refused, self._said = self._said, []
        waiting: list[RemoteCommand] = []
        while not self._commands.empty():
            command = self._commands.get()
            if waiting and isinstance(command, PalmCommand) and isinstance(waiting[-1], PalmCommand):
                waiting.pop()
            waiting.append(command)
        for command in waiting:
            try:
                self._do(command, arm)
            except CommandError as error:
                refused.append(str(error))
        # The palm goes straight and turns about itself; a flange that did would swing it.
        self._at, self._t = approach(self._at, self._goal, arm.t - self._t, self._smoothing), arm.t
        self.guide.target.move(self.cell.robot.flange_for(self._at))
        return refused

    def _do(self, command: RemoteCommand, arm: HandState) -> None:
        match command:
            case PalmCommand() | FingersCommand() if self._stopped:
                if not self._told:  # Once a stop: some send a hundred a second.
                    self._told = True
                    raise CommandError("the cell is stopped, and nothing moves it before the stop is released")
            case PalmCommand(pose):
                self._goal = self._limits.check_palm(pose, self._at, arm.position, self.fingers(arm.t).position)
            case FingersCommand(times, postures, velocities):
                path = self._timed(times, postures, velocities, arm.t)
                self._limits.check_fingers(path, self.cell.robot.palm(arm))
                self._path, self._since = path, arm.t
            case ReleaseCommand():
                self._stopped = False
            case StayCommand() | StopCommand():
                if isinstance(command, StopCommand):
                    self._stopped, self._told = True, False
                self._goal = self._at = self.cell.robot.palm(arm)
                self._path, self._since = SmoothSetpoint(self.fingers(arm.t).position), arm.t

    def _timed(self, times: Vector, postures: Array, velocities: Array | None, t: float) -> TimedPath:
        times = np.asarray(times, dtype=np.float64)
        if not len(times) or not np.isfinite(times).all() or times[0] <= 0.0 or (np.diff(times) <= 0.0).any():
            raise CommandError(f"fingers: times must ascend from above 0 s; they are {times[:6].tolist()}")
        here, spec = self.fingers(t).position, self.cell.hand.spec
        try:
            postures = np.array([spec.measured_posture(row, "fingers") for row in postures])
        except ConfigError as error:
            raise CommandError(str(error)) from error
        rates = None if velocities is None else np.vstack([np.zeros_like(here), velocities])
        return TimedPath(np.concatenate([[0.0], times]), np.vstack([here, postures]), rates)


def run_remote_control(
    remote: RemoteControl,
    observers: Observers,
    until: Callable[[float], bool] = lambda t: False,
    speed: float | None = 1.0,
) -> None:
    """Turn the cell's loop until that is so at a time, s, at `speed` times real time; None: as fast as it goes.

    Raises HandFault and LinkError, which end it.
    """
    cell, spec = remote.cell, remote.cell.hand.spec
    observers.on_remote_control(remote.guide, remote.fingers)
    law = arm_controller(cell, remote.guide)
    grip = PD(remote, load_gains(cell.settings.hand.gains, spec), GravityFeedforward(cell.model.gravity_torque))
    arms: Iterator[Sample] = run_through_reflexes(cell.arm, law, remote.on_reflex)
    if speed is not None:
        arms = paced(arms, speed)
    hands = observers.hand(run(cell.hand, grip))
    for which, sample in interleave((observers.arm(arms), cell.arm.period), (hands, cell.hand.period)):
        if which == 0:
            for sentence in remote.update(sample.state):
                observers.on_refusal(sample.state.t, sentence)
            if until(sample.state.t):
                return
