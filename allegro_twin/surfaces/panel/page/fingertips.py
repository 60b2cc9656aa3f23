"""Handles at the fingertips, which are dragged in the picture."""

from __future__ import annotations

from typing import Any

import numpy as np

from allegro_twin.hands.description.appearance import series_color
from allegro_twin.surfaces.panel.page.html import BAD, CALM
from allegro_twin.surfaces.panel.page.page_state import Browser, update
from allegro_twin.surfaces.panel.page.scene import PALM
from allegro_twin.surfaces.panel.requests import MoveJoints
from allegro_twin.surfaces.panel.stream import StreamFrame

_SCALE = 0.035
"""m: how long the arrows are that one drags."""
_DOT = 0.006  # m: of the mark where a tip cannot be.
_PAUSE, _SAME = 3, 1e-4  # Refreshes, as of the sliders; m.


class TipHandles:
    """Three arrows at each tip. A tip that cannot be where it was dragged to says so: a red mark there, a line to the
    nearest place in reach, and the joints' goals stay."""

    def __init__(self, browser: Browser) -> None:
        self._browser, self._state, self._client = browser, browser.state, browser.client
        self._on, self._left_alone, self._able = not browser.info.episode, 0, False
        self._controls: dict[str, Any] = {}
        self._marks: list[Any] = []
        info, gui = browser.info, self._client.gui
        self._text = gui.add_html("")
        if self._state.tip_ik is None:
            self._say(f"fingertips of this hand cannot be dragged: {info.no_tips}", CALM)
            return
        box = gui.add_checkbox("Drag fingertips", initial_value=self._on, hint="Three arrows at each tip")
        box.on_update(self._switched)
        for finger in info.spec.fingers:
            self._controls[finger.name] = self._control(finger.name)

    def _control(self, finger: str) -> Any:
        control = self._client.scene.add_transform_controls(
            f"{PALM}/drag_{finger}", scale=_SCALE, line_width=3.0, disable_rotations=True, disable_sliders=True,
            depth_test=False, visible=False,
        )  # fmt: skip

        async def dragged(event: Any) -> None:
            self._left_alone = _PAUSE
            self._drag(finger, np.array(control.position))

        async def dropped(event: Any) -> None:
            self._left_alone = 0
            self._unmark()

        control.on_update(dragged)
        control.on_drag_end(dropped)
        return control

    def _drag(self, finger: str, point: Any) -> None:
        state = self._state
        if not self._able or state.tip_ik is None or state.frame is None:
            return
        found = state.tip_ik.drag(finger, point, state.frame.goal)
        if found.posture is not None:
            self._unmark()
            self._browser.ask(MoveJoints.of(self._browser.info.spec.n_joints, found.posture))
            return
        self._mark(point, found.nearest)
        self._say(f"{finger}: out of reach by {1000 * found.distance:.0f} mm; the joints stay")

    def refresh(self, frame: StreamFrame) -> None:
        self._left_alone -= 1
        if self._left_alone >= 0 or self._state.tip_ik is None:
            return
        self._unmark()
        for finger, control in self._controls.items():
            tip = self._state.tip_ik.tip(finger, frame.goal)
            if np.abs(tip - control.position).max() > _SAME:
                control.position = tip

    def enable(self, on: bool) -> None:
        self._able = on
        self._show()

    def remove(self) -> None:
        """Take everything out of the picture."""
        self._unmark()
        for control in self._controls.values():
            control.remove()
        self._controls.clear()

    async def _switched(self, event: Any) -> None:
        self._on = bool(event.target.value)
        self._show()

    def _show(self) -> None:
        for control in self._controls.values():
            control.visible = self._on and self._able

    def _mark(self, point: Any, nearest: Any) -> None:
        self._unmark()
        scene, red = self._client.scene, (200, 16, 46)
        line = np.array([[point, nearest]], dtype=np.float32)
        self._marks = [
            scene.add_icosphere(f"{PALM}/out_of_reach", radius=_DOT, color=red, position=point, cast_shadow=False),
            scene.add_icosphere(f"{PALM}/nearest", radius=_DOT / 2, color=_rgb(), position=nearest, cast_shadow=False),
            scene.add_line_segments(f"{PALM}/short", line, red, line_width=3.0),
        ]

    def _unmark(self) -> None:
        for mark in self._marks:
            mark.remove()
        self._marks = []
        self._say("")

    def _say(self, text: str, color: str = BAD) -> None:
        content = f'<div style="font:12px system-ui;padding:2px 12px;color:{color}">{text}</div>' if text else ""
        update(self._text, content=content)


def _rgb() -> tuple[int, int, int]:
    red, green, blue = (round(255 * part) for part in series_color(0))
    return red, green, blue
