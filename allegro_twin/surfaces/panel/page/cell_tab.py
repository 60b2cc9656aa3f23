"""One browser that looks at a cell: the marker that its palm goes to, three numbers of the same, and its buttons."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import TYPE_CHECKING

import numpy as np
import viser

from allegro_twin.surfaces.panel import requests as w
from allegro_twin.surfaces.panel.cell import CellFrame, Place
from allegro_twin.surfaces.panel.page.bars import banner
from allegro_twin.surfaces.panel.stream import Notice
from allegro_twin.types import Vector

if TYPE_CHECKING:
    from allegro_twin.surfaces.panel.page.parts import CellBoard

_GOOD, _BAD, _CALM = "#0a7d38", "#c8102e", "#555"
_SCALE = 0.16  # m: how long the marker's arrows are.
_PAUSE = 6
"""Refreshes, a second of them, in which what a person has just moved stays as they left it."""
_SAME = 1e-3  # m, and of a quaternion.


class CellTab:
    """Everything in it is this browser's own."""

    def __init__(self, board: CellBoard, client: viser.ClientHandle) -> None:
        self._board, self._client, self.who = board, client, client.client_id
        self._left_alone = 0
        gui, opened = client.gui, board.opened
        gui.set_panel_label("Cell" if opened is None else opened.title)
        self._banner = gui.add_html("")
        self._wheel = gui.add_button("Drive", icon=viser.Icon.STEERING_WHEEL)
        self._free = gui.add_button("Release the stop", color="red", visible=False)
        self._hold = gui.add_button("Stay here", icon=viser.Icon.HAND_STOP)
        self._numbers = gui.add_vector3("Palm to (m)", (0.0, 0.0, 0.0), step=0.01, hint="In the world; the marker's")
        self._marker = client.scene.add_transform_controls(
            "/marker", scale=_SCALE, line_width=4.0, disable_sliders=True, depth_test=False, visible=False
        )
        self._wheel.on_click(self._take)
        self._free.on_click(self._wishing(w.Release()))
        self._hold.on_click(self._wishing(w.Hold()))
        self._numbers.on_update(self._typed)
        self._marker.on_update(self._dragged)
        self._marker.on_drag_end(self._dropped)

    def tell(self, notice: Notice) -> None:
        """Something to read, for a while."""
        title, color = ("Not done", "red") if notice.bad else ("The cell", "blue")
        self._client.add_notification(title, notice.text, auto_close_seconds=6.0, color=color)

    def refresh(self, frame: CellFrame | None) -> None:
        """Some six times a second."""
        board, drives = self._board, self._board.wheel.drives(self.who)
        stopped = frame is not None and frame.stopped
        lines = [(_GOOD, "You drive: drag the marker") if drives else (_CALM, "You look on. STOP is for everybody")]
        if frame is None:
            lines.append((_CALM, "The cell is being opened …"))
        elif stopped:
            lines.append((_BAD, "STOPPED: arm and fingers stay until the stop is released"))
        else:
            x, y, z = frame.poses["tool"][:3]
            lines.append((_CALM, f"Palm at {x:+.3f}, {y:+.3f}, {z:+.3f} m · {frame.t:.1f} s"))
        if board.notice.text:
            lines.append((_BAD if board.notice.bad else _CALM, board.notice.text))
        content = banner(lines)
        if self._banner.content != content:
            self._banner.content = content
        self._wheel.label = "Let go" if drives else "Drive"
        self._free.visible, self._free.disabled = stopped, not drives
        able = drives and not stopped and frame is not None
        self._hold.disabled = self._numbers.disabled = not able
        if self._marker.visible is not able:
            self._marker.visible = able
        self._left_alone -= 1
        if frame is not None and self._left_alone < 0:
            self._follow(frame.poses["goal"])

    def _follow(self, goal: Vector) -> None:
        """Where the palm is to go now: a wish that was refused goes back to it."""
        if max(np.abs(self._marker.position - goal[:3]).max(), np.abs(self._marker.wxyz - goal[3:]).max()) > _SAME:
            self._marker.position, self._marker.wxyz = goal[:3], goal[3:]
        if np.abs(np.array(self._numbers.value) - goal[:3]).max() > _SAME:
            x, y, z = (round(float(value), 3) for value in goal[:3])
            self._numbers.value = (x, y, z)

    async def _dragged(self, event: object) -> None:
        self._left_alone = _PAUSE
        self._ask(np.concatenate([self._marker.position, self._marker.wxyz]))

    async def _dropped(self, event: object) -> None:
        self._left_alone = _PAUSE

    async def _typed(self, event: viser.GuiEvent[viser.GuiVector3Handle]) -> None:
        if event.client is None:
            return  # The program itself has set it.
        self._left_alone = _PAUSE
        self._ask(np.concatenate([self._numbers.value, self._marker.wxyz]))

    def _ask(self, pose: Vector) -> None:
        self._board.ask(self.who, Place(tuple(float(value) for value in pose)))

    async def _take(self, event: object) -> None:
        board = self._board
        if board.wheel.drives(self.who):
            board.release(self.who)
        else:
            board.wheel.take(self.who)

    def _wishing(self, wish: w.Wish) -> Callable[[object], Coroutine[None, None, None]]:
        async def click(event: object) -> None:
            self._board.ask(self.who, wish)

        return click
