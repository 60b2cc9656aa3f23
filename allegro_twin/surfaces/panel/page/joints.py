"""A slider for every motor, finger by finger: its goal, with the measured position and the torque in the same row."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from allegro_twin.surfaces.panel.page.html import joint_groups, joint_states, units
from allegro_twin.surfaces.panel.page.page_state import PAUSE, Browser, update
from allegro_twin.surfaces.panel.requests import MoveJoints
from allegro_twin.surfaces.panel.stream import StreamFrame

if TYPE_CHECKING:
    import viser

_SAME = 2e-3  # rad: a slider this near to its joint is not moved.


class JointSliders:
    """A slider sets the goal of a joint; left alone it follows the goal."""

    def __init__(self, browser: Browser) -> None:
        self._browser, self._spec = browser, browser.info.spec
        self._sliders: dict[int, Any] = {}
        self._left_alone = 0
        self._before = np.full(self._spec.n_joints, np.nan)
        gui = browser.client.gui
        self._states = gui.add_html("")
        for group in joint_groups(self._spec):
            with gui.add_folder(group.name):
                for joint in group.joints:
                    self._sliders[joint] = self._slider(gui, joint)

    def _slider(self, gui: viser.GuiApi, joint: int) -> Any:
        spec = self._spec
        lower, upper = _ceiled(spec.lower[joint]), _floored(spec.upper[joint])
        start = min(max(0.0, lower), upper)
        hint = f"{lower:g} to {upper:g} {units(spec)}"
        slider = gui.add_slider(spec.joint_labels[joint], lower, upper, 0.001, start, hint=hint)

        async def moved(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is None:
                return  # It followed the hand.
            self._left_alone = PAUSE
            self._browser.ask(MoveJoints.of(spec.n_joints, {joint: event.target.value}))

        slider.on_update(moved)
        return slider

    def refresh(self, frame: StreamFrame) -> None:
        update(self._states, content=joint_states(self._spec, frame))
        self._left_alone -= 1
        if self._left_alone >= 0:
            return
        goal, before = frame.goal, self._before
        self._before = goal
        for joint, slider in self._sliders.items():
            # While a joint is on its way its slider rests: the program's and the person's values would cross.
            if abs(goal[joint] - before[joint]) < _SAME < abs(slider.value - goal[joint]):
                slider.value = float(np.clip(goal[joint], slider.min, slider.max))

    def enable(self, on: bool) -> None:
        for slider in self._sliders.values():
            slider.disabled = not on


def _ceiled(value: float) -> float:
    return float(np.ceil(value * 1000.0) / 1000.0)


def _floored(value: float) -> float:
    return float(np.floor(value * 1000.0) / 1000.0)
