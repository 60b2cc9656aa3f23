"""Markers that a person drags, with numbers of the same: the palm of a cell, and the goal of an object."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
import viser

from allegro_twin.kinematics.orientation import euler_from_matrix, matrix_from_quaternion, quaternion_from_euler
from allegro_twin.surfaces.panel.page.html import episode_state
from allegro_twin.surfaces.panel.page.page_state import Browser, update
from allegro_twin.surfaces.panel.requests import MovePalm, PerformEpisode, Request, TurnGoal
from allegro_twin.surfaces.panel.stream import StreamFrame
from allegro_twin.types import Vector

_SCALE = 0.16  # m: how long the marker's arrows are.
_PAUSE = 6
"""Refreshes, a second of them, in which what a person has just moved stays as they left it."""
_SAME = 1e-3  # m, and of a quaternion.
_RING = 0.09  # m: how wide the rings are that turn a goal.
_SAME_TURN, _SAME_ANGLE = 1e-7, 0.1
"""Tolerances of equal orientations: of the cosine of half an angle, 0.05°; and of an angle, degrees."""


class PalmMarker:
    """Handle of the palm's goal; it returns to the goal where a request was refused."""

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


class EpisodeView:
    """The task of an episode; where its goal is an orientation, a handle and three angles turn it."""

    def __init__(self, browser: Browser) -> None:
        self._browser, self._left_alone, self._able, info = browser, 0, False, browser.info
        gui, scene = browser.client.gui, browser.client.scene
        self._text = gui.add_html("")
        how = "The planner of the config does it, from here on" if info.plans else "By the controller of the config"
        self._perform = gui.add_button("Perform the task", icon=viser.Icon.PLAYER_PLAY, hint=how)
        self._perform.on_click(self._asking(PerformEpisode()))
        self._angles: Any = None
        if not info.turns:
            return
        self._angles = gui.add_vector3("Goal (°)", (0.0, 0.0, 0.0), step=5.0, hint="Roll, pitch and yaw in the world")
        self._again = gui.add_button("Goals of the task", hint="Ends the goal that you have set")
        self._ring = scene.add_transform_controls(
            "/turn_goal", scale=_RING, line_width=3.0, disable_axes=True, disable_sliders=True, depth_test=False,
            visible=False,
        )  # fmt: skip
        self._again.on_click(self._asking(TurnGoal(None)))
        self._angles.on_update(self._typed)
        self._ring.on_update(self._dragged)
        self._ring.on_drag_end(self._dropped)

    def refresh(self, frame: StreamFrame) -> None:
        update(self._text, content=episode_state(self._browser.info, frame))
        if self._angles is None:
            return
        update(self._again, disabled=not self._able or not frame.look["episode"][4])
        self._left_alone -= 1
        if self._left_alone >= 0:
            return
        goal, ring = frame.look["object_goal"], self._ring
        if np.abs(ring.position - goal[:3]).max() > _SAME or abs(ring.wxyz @ goal[3:]) < 1.0 - _SAME_TURN:
            ring.position, ring.wxyz = goal[:3], goal[3:]
        angles = np.degrees(euler_from_matrix(matrix_from_quaternion(goal[3:])))
        if np.abs(np.array(self._angles.value) - angles).max() > _SAME_ANGLE:
            roll, pitch, yaw = (round(float(value), 1) + 0.0 for value in angles)
            self._angles.value = (roll, pitch, yaw)

    def enable(self, on: bool) -> None:
        self._able = on
        self._perform.disabled = not on
        if self._angles is not None:
            self._angles.disabled = self._again.disabled = not on
            self._ring.visible = on

    def remove(self) -> None:
        """Take the handle out of the picture."""
        if self._angles is not None:
            self._ring.remove()

    async def _dragged(self, event: object) -> None:
        self._ask(self._ring.wxyz)

    async def _dropped(self, event: object) -> None:
        self._left_alone = _PAUSE

    async def _typed(self, event: object) -> None:
        if getattr(event, "client", None) is not None:  # Else the program itself has set it.
            self._ask(quaternion_from_euler(np.radians(self._angles.value)))

    def _ask(self, quaternion: Vector) -> None:
        self._left_alone = _PAUSE
        self._browser.ask(TurnGoal(tuple(float(value) for value in quaternion)))

    def _asking(self, request: Request) -> Callable[[object], Coroutine[None, None, None]]:
        async def click(event: object) -> None:
            self._left_alone = 0
            self._browser.ask(request)

        return click
