"""The controller, its gains, gravity, and the scene."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from typing import Any

import viser

from allegro_twin.surfaces.panel import requests
from allegro_twin.surfaces.panel.page.html import CALM, FONT
from allegro_twin.surfaces.panel.page.page_state import PAUSE, Browser, update
from allegro_twin.surfaces.panel.stream import SessionInfo, StreamFrame

_NONE, _OWN = "no scenario", "the scenario's own"
_KINDS = {
    "torque": "zero torque",
    "gravity": "only its own weight",
    "limp": "the motors let go",
    "position": "its own loop holds it where it is",
}
_DOWN = (0.0, 0.0, -9.81)  # m/s², palm frame: fingers up.


class ControllerView:
    """A choice counts at once, but for the scene, which opens the hand anew."""

    def __init__(self, browser: Browser) -> None:
        self._browser, self._gui, info = browser, browser.client.gui, browser.info
        self._kinds: dict[str, Any] = {}
        self._inputs: list[Any] = []
        self._gains: Any = None
        self._reported: Any = None
        self._left_alone = 0
        with self._gui.add_folder("Controller"):
            for kind in info.kinds:
                self._kinds[kind] = self._gui.add_button(kind, color="gray", hint=_KINDS.get(kind))
                self._kinds[kind].on_click(self._choosing(kind))
            if len(info.gains) > 1:
                self._gains = self._gui.add_dropdown("Gains", info.gains)
                self._gains.on_update(self._choose_gains)
                self._inputs.append(self._gains)
        self._inputs += self._kinds.values()
        if "gravity" in info.kinds:  # Else no controller carries the hand's weight: it does so itself.
            self._add_gravity()
        if info.scenarios:
            self._add_scene(info)
        self._gui.add_html(_about_pulling(info.no_drag))

    def _add_gravity(self) -> None:
        with self._gui.add_folder("Gravity"):
            self._reported = self._gui.add_checkbox("As the hand reports", initial_value=True)
            self._vector = self._gui.add_vector3("m/s², palm", _DOWN, step=0.01, visible=False)
        self._inputs += [self._reported, self._vector]
        self._reported.on_update(self._set_gravity)
        self._vector.on_update(self._set_gravity)

    def _add_scene(self, info: SessionInfo) -> None:
        gui, scenario, object_name = self._gui, info.scenario, info.object_name
        none = f"episode of {info.episode}" if info.episode else _NONE
        with gui.add_folder("Scene"):
            chosen = gui.add_dropdown("Scenario", choices(none, info.scenarios, scenario),
                                      initial_value=scenario or none)  # fmt: skip
            other = gui.add_dropdown(
                "Object", choices(_OWN, info.object_names, object_name), initial_value=object_name or _OWN
            )
            place = gui.add_button("Set the scene", hint="Opens the simulated hand anew, limp, at its beginning")
            perform = gui.add_button("Perform it", hint="From its beginning to the verdict, by its own controller")

        def asking(*, perform: bool) -> Callable[[Any], Any]:
            async def click(event: Any) -> None:
                named = None if chosen.value == none else chosen.value
                object_name = None if other.value == _OWN or named is None else other.value
                self._browser.ask(requests.OpenScene(named, object_name, perform))

            return click

        place.on_click(asking(perform=False))
        perform.on_click(asking(perform=True))
        self._inputs += [chosen, other, place, perform]

    def refresh(self, frame: StreamFrame) -> None:
        """Mark the active controller, and show the gains and the gravity in use; what was just touched is left to the
        person."""
        for kind, button in self._kinds.items():
            active = kind == frame.kind
            update(button, color="blue" if active else "gray", icon=viser.Icon.CHECK if active else None)
        self._left_alone -= 1
        if self._left_alone >= 0:
            return
        if self._gains is not None and frame.gains in self._gains.options:
            update(self._gains, value=frame.gains)
        if self._reported is not None:
            update(self._reported, value=frame.gravity is None)
            update(self._vector, visible=frame.gravity is not None)
            if frame.gravity is not None:
                update(self._vector, value=frame.gravity)

    def enable(self, on: bool) -> None:
        for each in self._inputs:
            each.disabled = not on

    async def _set_gravity(self, event: Any) -> None:
        if event.client_id is None:
            return
        self._left_alone = PAUSE
        self._vector.visible = not self._reported.value
        x, y, z = self._vector.value
        self._browser.ask(requests.SetGravity(None if self._reported.value else (x, y, z)))

    def _choosing(self, kind: str) -> Callable[[Any], Any]:
        async def click(event: Any) -> None:
            self._browser.ask(requests.ChooseController(kind))

        return click

    async def _choose_gains(self, event: Any) -> None:
        if event.client_id is None:
            return
        self._left_alone = PAUSE
        self._browser.ask(requests.ChooseGains(event.target.value))


def _about_pulling(why_not: str) -> str:
    text, color, hint = (
        "Drag an object in the picture to pull it",
        CALM,
        "A spring pulls it towards the mouse, with the force that the picture shows",
    )
    if why_not:
        text, color, hint = "Objects cannot be pulled with the mouse (?)", "#999", why_not
    return f'<div style="{FONT};color:{color};cursor:help" title="{escape(hint)}">{text}</div>'


def choices(first: str, names: tuple[str, ...], chosen: str | None) -> tuple[str, ...]:
    """The choices; one that was chosen by a path is among them."""
    more = () if chosen is None or chosen in names else (chosen,)
    return (first, *more, *names)
