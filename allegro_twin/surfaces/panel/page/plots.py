"""Live curves of one finger."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import viser
from viser import uplot

from allegro_twin.hands.description.appearance import LIMIT, lighten, series_color
from allegro_twin.surfaces.panel.page.bars import name_of
from allegro_twin.surfaces.panel.page.groups import Group, groups, units
from allegro_twin.surfaces.panel.stream import Frame

if TYPE_CHECKING:
    from allegro_twin.surfaces.panel.page.parts import Board

_SECONDS, _ROWS = 10.0, 150
_HEIGHT = 210  # Pixels.


class Plots:
    """Positions with where they should be, and torques with their limits: the newest ten seconds."""

    def __init__(self, board: Board, gui: viser.GuiApi) -> None:
        opened = board.opened
        assert opened is not None
        self._board, self._gui, self._spec = board, gui, opened.spec
        self._groups = {group.name: group for group in groups(self._spec)}
        self._on = gui.add_checkbox("Live", initial_value=False, hint="They cost the browser and the link their share")
        self._finger = gui.add_dropdown("Finger", tuple(self._groups))
        self._place = gui.add_folder("Curves")
        self._charts: tuple[Any, Any] | None = None
        self._shown = ""

    def refresh(self, frame: Frame) -> None:
        if not self._on.value:
            return
        group = self._groups[self._finger.value]
        joints = list(group.joints)
        t, position, target, torque = self._board.history.rows(_SECONDS, _ROWS)
        if len(t) < 2:
            return
        target = np.where(np.isnan(target), position, target)  # uPlot never comes back from a NaN.
        limits = np.unique(self._spec.actuation.torque_limit[joints])
        lines = np.tile(np.concatenate([limits, -limits])[:, None], len(t))
        rows = ((t, *position[:, joints].T, *target[:, joints].T), (t, *torque[:, joints].T, *lines))
        if self._charts is None or self._shown != group.name:
            self._draw(group, rows, len(limits))
            return
        for chart, data in zip(self._charts, rows, strict=True):
            chart.data = tuple(np.ascontiguousarray(column) for column in data)

    def enable(self, on: bool) -> None:
        """Who looks on may look at curves."""

    def _draw(self, group: Group, rows: Any, limits: int) -> None:
        for chart in self._charts or ():
            chart.remove()
        names = [name_of(self._spec, joint) for joint in group.joints]
        color = [_css(series_color(k)) for k in range(len(names))]
        goals = [_series(f"{n} goal", _css(lighten(series_color(k))), 1) for k, n in enumerate(names)]
        ends = [_series("limit", _css(LIMIT), 1) for _ in range(2 * limits)]
        measured = [_series(name, c, 2) for name, c in zip(names, color, strict=True)]
        with self._place:  # Else they would stand below every tab.
            self._charts = (self._chart(f"position, {units(self._spec)}", rows[0], [*measured, *goals]),
                            self._chart("torque, N·m", rows[1], [*measured, *ends]))  # fmt: skip
        self._shown = group.name

    def _chart(self, title: str, data: Any, series: list[Any]) -> Any:
        return self._gui.add_uplot(
            tuple(np.ascontiguousarray(column) for column in data),
            (uplot.Series(label="s"), *series),
            title=title,
            scales={"x": uplot.Scale(time=False, auto=True), "y": uplot.Scale(auto=True)},
            legend=uplot.Legend(show=False),
            height=_HEIGHT,
        )


def _series(label: str, color: str, width: int) -> Any:
    return uplot.Series(label=label, stroke=color, width=width)


def _css(color: tuple[float, float, float]) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in color)
