"""A cell under remote control as a session of the panel: an observer of its events, whose requests move its palm."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Self

import numpy as np

from allegro_twin.cell.journal.recording import cell_look
from allegro_twin.cell.remote.remote_control import (
    PalmCommand,
    ReleaseCommand,
    RemoteControl,
    StayCommand,
    StopCommand,
)
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.kinematics.pose import Pose
from allegro_twin.recording.events import DeviceSample, SessionEvent
from allegro_twin.surfaces.panel import requests
from allegro_twin.surfaces.panel.host import Opener, Send
from allegro_twin.surfaces.panel.stream import RATE, Notice, SessionInfo, StreamFrame
from allegro_twin.viewing.scenery import scenery


class CellSession:
    """A cell that is there once and for all; its loop turns elsewhere and calls `on_event`."""

    def __init__(self, remote: RemoteControl) -> None:
        self._remote, self._number, self._next = remote, 0, 0.0
        self._send: Send | None = None
        self._hand: DeviceSample | None = None
        self._notices: list[Notice] = []

    def prepare(self, request: requests.OpenScene | requests.Reopen | None) -> Opener:
        """Raises ConfigError for another scene."""
        if request is not None:
            raise ConfigError("a cell cannot be opened anew from here")
        return self._start

    def _start(self, number: int, send: Send) -> Self:
        self._number, self._send = number, send
        return self

    def describe(self) -> SessionInfo:
        """Its title, its devices and its shapes."""
        cell = self._remote.cell
        arm, hand = cell.robot.spec, cell.hand.spec
        scene = scenery(hand, {"look": cell_look(cell)})
        return SessionInfo(self._number, f"{arm.name} with {hand.name} · simulated", hand, scene, arm=arm)

    def library(self) -> None:
        """A cell has none."""

    def execute(self, request: requests.Request) -> str:
        """Raises ConfigError."""
        match request:
            case requests.ReleaseStop():
                self._remote.command(ReleaseCommand())
            case requests.HoldHere():
                self._remote.command(StayCommand())
            case requests.MovePalm(pose):
                values = np.array(pose)
                self._remote.command(PalmCommand(Pose(values[:3], matrix_from_quaternion(values[3:]))))
        return ""

    def stop(self) -> None:
        """Stand still until the stop is released."""
        self._remote.command(StopCommand())

    def stay(self) -> None:
        """Arm and fingers stay where they are."""
        self._remote.command(StayCommand())

    def report(self) -> Iterator[Notice]:
        """Refusals of the cell."""
        while self._notices:
            yield self._notices.pop(0)

    def close(self) -> str:
        """Whoever moved the cell from here is gone."""
        self.stay()
        return ""

    def on_event(self, event: SessionEvent) -> None:
        """In the cell's loop: as little as possible, and nothing that waits."""
        if not isinstance(event, DeviceSample):
            sentence = event.row.get("sentence") if event.track == "states" else None
            if sentence:
                self._notices.append(Notice(str(sentence), bad=True))
        elif event.device == "hand":
            self._hand = event
        elif self._hand is not None and self._send is not None and event.sample.state.t >= self._next:
            self._next = event.sample.state.t + 1.0 / RATE
            self._send(self._frame(event, self._hand))

    def _frame(self, arm: DeviceSample, hand: DeviceSample) -> StreamFrame:
        state, extras, goal = hand.sample.state, hand.extras, self._remote.goal
        look = {name: arm.extras[name] for name in ("flange", "force")} | {
            "palm": arm.extras["tool"],
            "goal": np.concatenate([goal.position, goal.quaternion]),
            "object": extras["object"],
            "others": extras["others"].reshape(-1, 7) if "others" in extras else np.empty((0, 7)),
        }
        return StreamFrame(
            self._number, arm.sample.state.t, state.position, state.torque, state.temperature, extras["target"], look,
            "", self._remote.stopped, 0, (), -1.0, False, arm.sample.state.position,
        )  # fmt: skip
