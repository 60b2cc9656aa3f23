"""A slider for every motor, finger by finger, with what it does below."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import viser

from allegro_twin.surfaces.panel import requests as w
from allegro_twin.surfaces.panel.page.bars import group_bars, name_of
from allegro_twin.surfaces.panel.page.groups import groups, units
from allegro_twin.surfaces.panel.stream import Frame

if TYPE_CHECKING:
    from allegro_twin.surfaces.panel.page.parts import Board, Tab

_PAUSE = 3
"""Refreshes for which a slider that was touched is left to the person: half a second."""
_SAME = 2e-3  # rad: a slider this near to its joint is not moved.


class JointSliders:
    """A slider says where a joint shall go; left alone it follows where the joint is wished to be."""

    def __init__(self, tab: Tab, board: Board, gui: viser.GuiApi) -> None:
        opened = board.opened
        assert opened is not None
        self._tab, self._board, self._spec = tab, board, opened.spec
        self._sliders: dict[int, Any] = {}
        self._bars: list[Any] = []
        self._left_alone = 0
        self._before = np.full(self._spec.n_joints, np.nan)
        self._groups = groups(self._spec)
        for group in self._groups:
            with gui.add_folder(group.name):
                for joint in group.joints:
                    self._sliders[joint] = self._slider(gui, joint)
                self._bars.append(gui.add_html(""))

    def _slider(self, gui: viser.GuiApi, joint: int) -> Any:
        spec = self._spec
        lower, upper = _ceiled(spec.lower[joint]), _floored(spec.upper[joint])
        start = min(max(0.0, lower), upper)
        slider = gui.add_slider(name_of(spec, joint), lower, upper, 0.001, start, hint=units(spec))

        async def moved(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is None:
                return  # It followed the hand.
            self._left_alone = _PAUSE
            goal = self._board.goal.copy()
            goal[joint] = event.target.value
            inside = np.clip(goal, spec.lower, spec.upper)
            self._tab.ask(w.Joints(tuple(inside.tolist())))

        slider.on_update(moved)
        return slider

    def refresh(self, frame: Frame) -> None:
        for group, bars in zip(self._groups, self._bars, strict=True):
            content = group_bars(self._spec, group, frame)
            if content != bars.content:
                bars.content = content
        self._left_alone -= 1
        if self._left_alone >= 0:
            return
        goal, before = self._board.goal, self._before
        self._before = goal
        for joint, slider in self._sliders.items():
            # While a joint is on its way its slider rests: what is set here and what a person sets would cross.
            if abs(goal[joint] - before[joint]) < _SAME < abs(slider.value - goal[joint]):
                slider.value = float(np.clip(goal[joint], slider.min, slider.max))

    def enable(self, on: bool) -> None:
        for slider in self._sliders.values():
            slider.disabled = not on


def _ceiled(value: float) -> float:
    return float(np.ceil(value * 1000.0) / 1000.0)


def _floored(value: float) -> float:
    return float(np.floor(value * 1000.0) / 1000.0)
