"""The controller, its gains, gravity, and the scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import viser

from allegro_twin.surfaces.panel import requests as w
from allegro_twin.surfaces.panel.stream import Frame

if TYPE_CHECKING:
    from allegro_twin.surfaces.panel.page.parts import Board, Tab

_NONE, _OWN = "no scenario", "the scenario's own"
_KINDS = {
    "torque": "zero torque",
    "gravity": "only its own weight",
    "limp": "the motors let go",
    "position": "its own loop holds it where it is",
}
_DOWN = (0.0, 0.0, -9.81)  # m/s², palm frame: fingers up.


class Choosing:
    """What is chosen here counts at once, but for the scene, which opens the hand anew."""

    def __init__(self, tab: Tab, board: Board, gui: viser.GuiApi) -> None:
        self._tab, self._gui = tab, gui
        opened = board.opened
        assert opened is not None
        with gui.add_folder("Controller"):
            hint = ". ".join(f"{kind}: {_KINDS[kind]}" for kind in opened.kinds if kind in _KINDS)
            kinds = gui.add_button_group("", opened.kinds, hint=hint)
            kinds.on_click(self._asking(lambda value: w.Control(value)))
            self._inputs: list[Any] = []
            if len(opened.gains) > 1:
                gains = gui.add_dropdown("Gains", opened.gains, initial_value=opened.used)
                gains.on_update(self._asking(lambda value: w.UseGains(value)))
                self._inputs.append(gains)
        if "gravity" in opened.kinds:  # Else no controller carries the hand's weight: it does so itself.
            self._weight(gui)
        if opened.scenarios:
            self._scene(gui, opened.scenarios, opened.things, opened.scenario, opened.thing)

    def _weight(self, gui: viser.GuiApi) -> None:
        with gui.add_folder("Gravity"):
            self._reported = gui.add_checkbox("As the hand reports", initial_value=True)
            self._vector = gui.add_vector3("m/s², palm", _DOWN, step=0.01, visible=False)
        self._inputs += [self._reported, self._vector]
        self._reported.on_update(self._gravity)
        self._vector.on_update(self._gravity)

    def _scene(
        self,
        gui: viser.GuiApi,
        scenarios: tuple[str, ...],
        things: tuple[str, ...],
        scenario: str | None,
        thing: str | None,
    ) -> None:
        with gui.add_folder("Scene"):
            chosen = gui.add_dropdown("Scenario", _with(_NONE, scenarios, scenario), initial_value=scenario or _NONE)
            other = gui.add_dropdown("Object", _with(_OWN, things, thing), initial_value=thing or _OWN)
            place = gui.add_button("Set the scene", hint="Opens the simulated hand anew, limp, at its beginning")
            perform = gui.add_button("Perform it", hint="From its beginning to the verdict, by its own controller")

        def wish(*, perform: bool) -> w.Scene:
            named = None if chosen.value == _NONE else chosen.value
            return w.Scene(named, None if other.value == _OWN or named is None else other.value, perform)

        async def set_it(event: Any) -> None:
            self._tab.ask(wish(perform=False))

        async def do_it(event: Any) -> None:
            self._tab.ask(wish(perform=True))

        place.on_click(set_it)
        perform.on_click(do_it)
        self._inputs += [chosen, other, place, perform]

    def refresh(self, frame: Frame) -> None:
        """Nothing here changes with time."""

    def enable(self, on: bool) -> None:
        for each in self._inputs:
            each.disabled = not on

    async def _gravity(self, event: Any) -> None:
        if event.client_id is None:
            return
        self._vector.visible = not self._reported.value
        x, y, z = self._vector.value
        self._tab.ask(w.Gravity(None if self._reported.value else (x, y, z)))

    def _asking(self, wish: Any) -> Any:
        async def changed(event: Any) -> None:
            if event.client_id is not None:
                self._tab.ask(wish(event.target.value))

        return changed


def _with(first: str, names: tuple[str, ...], chosen: str | None) -> tuple[str, ...]:
    """The choices; what was chosen by a path is one of them."""
    more = () if chosen is None or chosen in names else (chosen,)
    return (first, *more, *names)
