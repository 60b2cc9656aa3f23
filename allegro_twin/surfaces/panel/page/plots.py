"""Live curves of one finger."""

from __future__ import annotations

from typing import Any

import numpy as np
from viser import uplot

from allegro_twin.hands.description.appearance import LIMIT, Color, lighten, series_color
from allegro_twin.surfaces.panel.page.html import JointGroup, hexed, joint_groups, units
from allegro_twin.surfaces.panel.page.page_state import Browser
from allegro_twin.surfaces.panel.stream import StreamFrame

_SECONDS, _ROWS = 10.0, 150
_HEIGHT = 210  # Pixels.
_EVERY = 3  # Refreshes: curves change twice a second, a small part of what a browser without a GPU can take.


class Plots:
    """Positions with their goals, and torques with their limits: the newest ten seconds."""

    def __init__(self, browser: Browser) -> None:
        self._browser, self._gui, self._spec = browser, browser.client.gui, browser.info.spec
        self._groups = {group.name: group for group in joint_groups(self._spec)}
        self._on = self._gui.add_checkbox("Live", initial_value=True, hint="Off: the curves stand still")
        self._finger = self._gui.add_dropdown("Finger", tuple(self._groups))
        self._place = self._gui.add_folder("Curves")
        self._charts: tuple[Any, Any] | None = None
        self._shown, self._count = "", 0

    def refresh(self, frame: StreamFrame) -> None:
        self._count += 1
        group = self._groups[self._finger.value]
        if not self._on.value or (self._shown == group.name and self._count % _EVERY):
            return
        joints = list(group.joints)
        t, position, target, torque = self._browser.state.history.rows(_SECONDS, _ROWS)
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

    def _draw(self, group: JointGroup, rows: Any, limits: int) -> None:
        for chart in self._charts or ():
            chart.remove()
        names = [self._spec.joint_labels[joint] for joint in group.joints]
        goals = [_series(f"{n} goal", _css(lighten(series_color(k))), 1) for k, n in enumerate(names)]
        ends = [_series("limit", _css(LIMIT), 1) for _ in range(2 * limits)]
        measured = [_series(name, hexed(k), 2) for k, name in enumerate(names)]
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


def _css(color: Color) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in color)
