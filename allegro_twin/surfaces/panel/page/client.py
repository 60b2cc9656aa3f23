"""One browser's page: its banner, its buttons, and its tabs."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
import viser

from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.surfaces.panel import requests
from allegro_twin.surfaces.panel.page.controller_view import ControllerView
from allegro_twin.surfaces.panel.page.fingertips import TipHandles
from allegro_twin.surfaces.panel.page.html import BAD, CALM, GOOD, banner, health
from allegro_twin.surfaces.panel.page.joints import JointSliders
from allegro_twin.surfaces.panel.page.library_view import LibraryView
from allegro_twin.surfaces.panel.page.markers import EpisodeView, PalmMarker
from allegro_twin.surfaces.panel.page.page_state import Browser, PageState, Section, update
from allegro_twin.surfaces.panel.page.plots import Plots
from allegro_twin.surfaces.panel.page.timeline import Timeline
from allegro_twin.surfaces.panel.stream import Notice, StreamFrame
from allegro_twin.types import Vector

_LOOKS_ON = "you look on; somebody else drives, or nobody: press Drive"


class ClientPage:
    """Everything in it is this browser's own: nobody else sees what one who only looks on clicks at. `changed` is
    called when the browser begins or ends to drive."""

    def __init__(self, state: PageState, client: viser.ClientHandle, changed: Callable[[], None]) -> None:
        self._state, self._client, self._changed = state, client, changed
        self._browser = Browser(state, client, self._ask)
        self._sections: list[Section] = []
        self._enabled: bool | None = None
        self._picked: tuple[float, ...] | None = None
        gui, info = client.gui, state.info
        self._cell = info is not None and info.arm is not None
        gui.set_panel_label("Opening …" if info is None else info.title)
        self._banner = gui.add_html("")
        self._drive = gui.add_button("Drive", icon=viser.Icon.STEERING_WHEEL)
        self._release = gui.add_button("Release the stop", color="red", visible=False)
        self._again = gui.add_button("Open the hand again", color="orange", visible=False)
        self._hold = gui.add_button("Stay here" if self._cell else "Hold here", icon=viser.Icon.HAND_STOP)
        self._drive.on_click(self._drive_or_let_go)
        self._hold.on_click(self._asking(requests.HoldHere()))
        self._release.on_click(self._asking(requests.ReleaseStop()))
        self._again.on_click(self._asking(requests.Reopen()))
        if info is not None:
            self._build(gui)
        self._show_state()

    def rebuilt(self) -> ClientPage:
        """The page of the same browser for another session."""
        for section in self._sections:
            if isinstance(section, TipHandles | EpisodeView):
                section.remove()
        self._client.gui.reset()
        return ClientPage(self._state, self._client, self._changed)

    def tell(self, notice: Notice) -> None:
        """A sentence to read, for a while."""
        whose = "The cell" if self._cell else "The hand"
        self._client.add_notification(
            "Not done" if notice.bad else whose, notice.text, auto_close_seconds=6.0,
            color="red" if notice.bad else "blue",
        )  # fmt: skip

    def fill(self) -> None:
        """The library is there, or has changed."""
        for section in self._sections:
            if isinstance(section, LibraryView):
                section.fill()

    def drag(self, number: int, event: Any, pose: Vector | None) -> None:
        """The mouse drags an object, whose pose as it is drawn is `pose`, (7,)."""
        if event.phase == "end":
            if self._picked is not None:
                self._picked = None
                self._state.request(requests.DropObject())  # Also of a browser that drives no longer.
            return
        if event.phase == "start":
            self._picked = self._pick(event, pose)
        if self._picked is not None:
            self._ask(requests.DragObject(number, _triple(self._picked), _triple(event.end_position)))

    def _pick(self, event: Any, pose: Vector | None) -> tuple[float, ...] | None:
        """The picked point in the object's frame; None, and a word why, where nothing may be pulled now."""
        refused = (
            _LOOKS_ON if not self._browser.drives
            else "nothing is pulled until the stop is released" if not self._enabled
            else "the picture is of the past; go back to now, then pull" if self._state.shown is not None
            else ""
        )  # fmt: skip
        if refused or pose is None:
            self.tell(Notice(refused or "the object is not there yet", bad=True))
            return None
        return tuple(matrix_from_quaternion(pose[3:]).T @ (np.array(event.start_position) - pose[:3]))

    def refresh(self) -> None:
        """Show the newest state, some six times a second."""
        self._show_state()
        if self._state.frame is not None:
            for section in self._sections:
                section.refresh(self._state.frame)

    def _build(self, gui: viser.GuiApi) -> None:
        browser = self._browser
        if self._cell:
            self._sections.append(PalmMarker(browser))
            return
        if task := browser.info.episode:
            with gui.add_folder(task):
                self._sections.append(EpisodeView(browser))
        tabs = gui.add_tab_group()
        with tabs.add_tab("Joints"):
            self._sections += [TipHandles(browser), JointSliders(browser)]
        for name, section in (("Library", LibraryView), ("Control", ControllerView), ("Time", Timeline),
                              ("Plots", Plots), ("Health", HealthView)):  # fmt: skip
            with tabs.add_tab(name):
                self._sections.append(section(browser))

    def _show_state(self) -> None:
        state, drives = self._state, self._browser.drives
        frame = state.frame
        stopped = frame is not None and frame.stopped
        lines = [self._who_drives(), self._what_happens(frame)]
        if state.shown is not None:
            old = f"{state.age:.1f} s old" if state.age >= 0.1 else "paused"
            lines.append((BAD, f"The picture is {old}; the hand goes on"))
        if frame is not None and "drag" in frame.look and state.info is not None:
            number, force = int(frame.look["drag"][0]), float(np.linalg.norm(frame.look["drag"][7:]))
            lines.append((CALM, f"The mouse pulls {list(state.info.scenery.objects)[number]} with {force:.1f} N"))
        if state.notice.text:
            lines.append((BAD if state.notice.bad else CALM, state.notice.text))
        update(self._banner, content=banner([line for line in lines if line[1]]))
        update(self._drive, label="Let go" if drives else "Drive", disabled=not (drives or state.lock.driver is None))
        update(self._release, visible=stopped and not state.ended, disabled=not drives)
        update(self._again, visible=bool(state.ended), disabled=not drives)
        able = drives and not stopped and not state.ended and (frame is not None or not self._cell)
        update(self._hold, disabled=not able)
        if self._enabled is not able:
            self._enabled = able
            for section in self._sections:
                section.enable(able)

    def _who_drives(self) -> tuple[str, str]:
        lock = self._state.lock
        others = lock.count - 1
        if self._browser.drives:
            watching = "" if not others else f"; {others} more look{'s' if others == 1 else ''} on"
            return GOOD, f"You drive{': drag the marker' if self._cell else ''}{watching}"
        if lock.driver is None:
            return BAD, "Nobody drives: press Drive"
        return CALM, "You look on; somebody else drives. STOP is for everybody"

    def _what_happens(self, frame: StreamFrame | None) -> tuple[str, str]:
        state, whose = self._state, "cell" if self._cell else "hand"
        if state.info is None:
            return CALM, "The session is being opened …"
        if state.ended:
            return BAD, f"The hand has ended: {state.ended}"
        if state.silent:
            return BAD, f"No news from the {whose} for a second"
        if frame is None:
            return CALM, ""
        if frame.stopped:
            what = "arm and fingers stay" if self._cell else "limp"
            return BAD, f"STOPPED: {what} until the stop is released · {frame.t:.1f} s"
        if self._cell:
            x, y, z = frame.look["palm"][:3]
            return CALM, f"Palm at {x:+.3f}, {y:+.3f}, {z:+.3f} m · {frame.t:.1f} s"
        kind = "off, the hand is limp" if frame.kind in ("torque", "limp") else frame.kind
        return CALM, f"Controller: {kind} · {frame.t:.1f} s"

    def _ask(self, request: requests.Request) -> None:
        if self._browser.drives:
            self._state.request(request)
        else:
            self.tell(Notice(_LOOKS_ON, bad=True))

    async def _drive_or_let_go(self, event: object) -> None:
        who = self._client.client_id
        if self._browser.drives:
            self._state.let_go(who)
        else:
            self._state.lock.take(who)
        self._changed()

    def _asking(self, request: requests.Request) -> Callable[[object], Coroutine[None, None, None]]:
        async def click(event: object) -> None:
            self._ask(request)

        return click


def _triple(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


class HealthView:
    """Lost periods, warnings of the link, and temperatures of the motors."""

    def __init__(self, browser: Browser) -> None:
        self._browser, self._text = browser, browser.client.gui.add_html("")

    def refresh(self, frame: StreamFrame) -> None:
        update(self._text, content=health(self._browser.info.spec, frame, self._browser.state.history.rate))

    def enable(self, on: bool) -> None:
        """There is nothing to press."""
