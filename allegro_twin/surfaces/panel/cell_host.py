"""The process that has the cell: an onlooker that tells the page, and the one who does what is wished there."""

from __future__ import annotations

import threading

import numpy as np

from allegro_twin.cell.journal.shapes import cell_look
from allegro_twin.cell.remote.remote_control import Led, Palm, Stay
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.kinematics.pose import Pose
from allegro_twin.recording.events import DeviceSample, SessionEvent
from allegro_twin.surfaces.panel import requests as w
from allegro_twin.surfaces.panel.cell import CellFrame, CellOpened, Place
from allegro_twin.surfaces.panel.page_process import Pages
from allegro_twin.surfaces.panel.session import RATE
from allegro_twin.surfaces.panel.stream import Notice, Sender
from allegro_twin.types import Vector


class CellHost:
    """Serves the page of one cell. What is wished there leads the cell, unless somebody has stopped it."""

    def __init__(self, led: Led, pages: Pages) -> None:
        self._led, self._page, self._next, self._stopped = led, pages.open(), 0.0, False
        self._send = Sender(self._page.frames)
        self._hand: DeviceSample | None = None
        threading.Thread(target=self._hear, name="wishes", daemon=True).start()

    def begin(self) -> str:
        """The page's address, when it is there. Raises ConfigError."""
        room = self._led.room
        bounds, arm, hand = room.settings.follow, room.cell.spec, room.hand.spec
        title = f"{arm.name} with {hand.name} · simulated"
        self._page.tell(CellOpened(title, arm, hand, cell_look(room), bounds.lower, bounds.upper))
        return self._page.address()

    def on_event(self, event: SessionEvent) -> None:
        """In the cell's loop: as little as possible, and nothing that waits."""
        if not isinstance(event, DeviceSample):
            sentence = event.row.get("sentence") if event.track == "states" else None
            if sentence:
                self._page.tell(Notice(str(sentence), bad=True))
        elif event.device == "hand":
            self._hand = event
        elif self._hand is not None and event.sample.state.t >= self._next:
            self._next = event.sample.state.t + 1.0 / RATE
            self._send(self._frame(event, self._hand))

    def close(self) -> None:
        """End the page."""
        self._page.close()

    def _frame(self, arm: DeviceSample, hand: DeviceSample) -> CellFrame:
        beside, look = arm.extras, hand.extras
        things = [look["object"], look["others"]] if "others" in look else [look["object"]]
        goal = self._led.goal
        poses = {
            "flange": beside["flange"], "tool": beside["tool"], "objects": np.concatenate(things),
            "goal": np.concatenate([goal.position, goal.quaternion]),
        }  # fmt: skip
        return CellFrame(
            arm.sample.state.t, arm.sample.state.position, hand.sample.state.position, poses, beside["force"][:3],
            self._stopped,
        )  # fmt: skip

    def _hear(self) -> None:
        for wish in self._page.wishes():
            match wish:
                case w.Stop():
                    self._stopped = True
                    self._led.wish(Stay())
                case w.Release():
                    self._stopped = False
                case w.Hold() | w.Gone():
                    self._led.wish(Stay())
                case Place(pose) if not self._stopped:
                    self._place(np.array(pose))
        self._led.wish(Stay())  # The page is gone, and whoever led the cell with it.

    def _place(self, pose: Vector) -> None:
        try:
            self._led.wish(Palm(_pose(pose)))
        except ConfigError as error:
            self._page.tell(Notice(str(error), bad=True))


def _pose(values: Vector) -> Pose:
    return Pose(values[:3], matrix_from_quaternion(values[3:]))
