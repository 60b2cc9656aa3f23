"""The palm of a cell: a marker in the picture that leads it, and three numbers of the same."""

from __future__ import annotations

import numpy as np

from allegro_twin.surfaces.panel.page.page_state import Browser
from allegro_twin.surfaces.panel.requests import MovePalm
from allegro_twin.surfaces.panel.stream import StreamFrame
from allegro_twin.types import Vector

_SCALE = 0.16  # m: how long the marker's arrows are.
_PAUSE = 6
"""Refreshes, a second of them, in which what a person has just moved stays as they left it."""
_SAME = 1e-3  # m, and of a quaternion.


class PalmMarker:
    """It goes back to the palm's goal where a request was refused."""

    def __init__(self, browser: Browser) -> None:
        self._browser, self._left_alone = browser, 0
        client = browser.client
        self._numbers = client.gui.add_vector3(
            "Palm to (m)", (0.0, 0.0, 0.0), step=0.01, hint="In the world; the marker's"
        )
        self._marker = client.scene.add_transform_controls(
            "/marker", scale=_SCALE, line_width=4.0, disable_sliders=True, depth_test=False, visible=False
        )
        self._numbers.on_update(self._typed)
        self._marker.on_update(self._dragged)
        self._marker.on_drag_end(self._dropped)

    def refresh(self, frame: StreamFrame) -> None:
        self._left_alone -= 1
        if self._left_alone >= 0:
            return
        goal, marker = frame.look["goal"], self._marker
        if max(np.abs(marker.position - goal[:3]).max(), np.abs(marker.wxyz - goal[3:]).max()) > _SAME:
            marker.position, marker.wxyz = goal[:3], goal[3:]
        if np.abs(np.array(self._numbers.value) - goal[:3]).max() > _SAME:
            x, y, z = (round(float(value), 3) for value in goal[:3])
            self._numbers.value = (x, y, z)

    def enable(self, on: bool) -> None:
        self._numbers.disabled, self._marker.visible = not on, on

    async def _dragged(self, event: object) -> None:
        self._ask(np.concatenate([self._marker.position, self._marker.wxyz]))

    async def _dropped(self, event: object) -> None:
        self._left_alone = _PAUSE

    async def _typed(self, event: object) -> None:
        if getattr(event, "client", None) is not None:  # Else the program itself has set it.
            self._ask(np.concatenate([self._numbers.value, self._marker.wxyz]))

    def _ask(self, pose: Vector) -> None:
        self._left_alone = _PAUSE
        self._browser.ask(MovePalm(tuple(float(value) for value in pose)))
