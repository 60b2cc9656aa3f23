"""One browser: its buttons, its bars, and what it is told."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import TYPE_CHECKING, Protocol

import viser

from allegro_twin.surfaces.panel import requests as w
from allegro_twin.surfaces.panel.page.bars import banner
from allegro_twin.surfaces.panel.page.controller_view import Choosing
from allegro_twin.surfaces.panel.page.health_view import Health
from allegro_twin.surfaces.panel.page.joints import JointSliders
from allegro_twin.surfaces.panel.page.library_view import Shelves
from allegro_twin.surfaces.panel.page.plots import Plots
from allegro_twin.surfaces.panel.page.timeline import Timeline
from allegro_twin.surfaces.panel.page.tip_handles import Tips
from allegro_twin.surfaces.panel.stream import Frame, Notice

if TYPE_CHECKING:
    from allegro_twin.surfaces.panel.page.parts import Board

_GOOD, _BAD, _CALM = "#0a7d38", "#c8102e", "#555"


class Section(Protocol):
    """A part of what one browser sees."""

    def refresh(self, frame: Frame) -> None:
        """Show a moment, some six times a second."""
        ...

    def enable(self, on: bool) -> None:
        """Whether it takes wishes."""
        ...


class Tab:
    """Everything in it is this browser's own: what one who only looks clicks at, nobody else sees."""

    def __init__(self, board: Board, client: viser.ClientHandle) -> None:
        self._board, self._client, self.who = board, client, client.client_id
        self._sections: list[Section] = []
        self._enabled: bool | None = None
        gui = client.gui
        gui.set_panel_label("A hand" if board.opened is None else board.opened.title)
        self._banner = gui.add_html("")
        self._wheel = gui.add_button("Drive", icon=viser.Icon.STEERING_WHEEL)
        self._free = gui.add_button("Release the stop", color="red", visible=False)
        self._again = gui.add_button("Open the hand again", color="orange", visible=False)
        self._hold = gui.add_button("Hold here", icon=viser.Icon.HAND_STOP)
        self._wheel.on_click(self._take)
        self._hold.on_click(self._wishing(w.Hold()))
        self._free.on_click(self._wishing(w.Release()))
        self._again.on_click(self._reopen)
        if board.opened is not None:
            self._build(gui)
        self._show_state()

    def anew(self) -> Tab:
        """The same browser, for another opening of the hand."""
        for section in self._sections:
            if isinstance(section, Tips):
                section.remove()
        self._client.gui.reset()
        return Tab(self._board, self._client)

    def ask(self, wish: w.Wish) -> None:
        self._board.ask(self.who, wish)

    def tell(self, notice: Notice) -> None:
        """Something to read, for a while."""
        self._client.add_notification(
            "The hand" if not notice.bad else "Not done", notice.text, auto_close_seconds=6.0,
            color="red" if notice.bad else "blue",
        )  # fmt: skip

    def fill(self) -> None:
        """The library is there, or has changed."""
        for section in self._sections:
            if isinstance(section, Shelves):
                section.fill()

    def refresh(self, frame: Frame | None) -> None:
        self._show_state()
        if frame is not None:
            for section in self._sections:
                section.refresh(frame)

    def _build(self, gui: viser.GuiApi) -> None:
        board, tabs = self._board, gui.add_tab_group()
        with tabs.add_tab("Joints"):
            self._sections += [Tips(self, board, self._client), JointSliders(self, board, gui)]
        with tabs.add_tab("Library"):
            self._sections.append(Shelves(self, board, gui))
        with tabs.add_tab("Control"):
            self._sections.append(Choosing(self, board, gui))
        with tabs.add_tab("Time"):
            self._sections.append(Timeline(self, board, gui))
        with tabs.add_tab("Plots"):
            self._sections.append(Plots(board, gui))
        with tabs.add_tab("Health"):
            self._sections.append(Health(board, gui))

    def _show_state(self) -> None:
        board, drives = self._board, self._board.wheel.drives(self.who)
        nobody, frame = board.wheel.driver is None, board.frame
        lines = [self._who_drives(drives=drives, nobody=nobody)]
        stopped = frame is not None and frame.stopped
        if board.opened is None:
            lines.append((_CALM, "The hand is being opened …"))
        elif board.ended:
            lines.append((_BAD, f"The hand has ended: {board.ended}"))
        elif board.quiet:
            lines.append((_BAD, "No news from the hand for a second"))
        elif frame is not None:
            what = "STOPPED: limp until the stop is released" if stopped else f"Controller: {_kind(frame)}"
            lines.append((_BAD if stopped else _CALM, f"{what} · {frame.t:.1f} s"))
        if board.ago is not None:
            lines.append((_BAD, f"The picture is {board.ago:.1f} s old; the hand goes on"))
        if board.notice.text:
            lines.append((_BAD if board.notice.bad else _CALM, board.notice.text))
        content = banner(lines)
        if self._banner.content != content:
            self._banner.content = content
        _put(self._wheel, label="Let go" if drives else "Drive", disabled=not (drives or nobody))
        _put(self._free, visible=stopped and not board.ended, disabled=not drives)
        _put(self._again, visible=bool(board.ended), disabled=not drives)
        able = drives and not stopped and not board.ended
        _put(self._hold, disabled=not able)
        if self._enabled is not able:
            self._enabled = able
            for section in self._sections:
                section.enable(able)

    def _who_drives(self, *, drives: bool, nobody: bool) -> tuple[str, str]:
        others = self._board.wheel.count - 1
        if drives:
            watching = "" if not others else f"; {others} more look{'s' if others == 1 else ''} on"
            return _GOOD, f"You drive{watching}"
        if nobody:
            return _BAD, "Nobody drives: press Drive"
        return _CALM, "You look on; somebody else drives. STOP is for everybody"

    async def _take(self, event: object) -> None:
        if self._board.wheel.drives(self.who):
            self._board.release(self.who)
        else:
            self._board.wheel.take(self.who)
            self._board.changed()

    async def _reopen(self, event: object) -> None:
        self.ask(w.Again())

    def _wishing(self, wish: w.Wish) -> Callable[[object], Coroutine[None, None, None]]:
        async def click(event: object) -> None:
            self.ask(wish)

        return click


def _kind(frame: Frame) -> str:
    return "off, the hand is limp" if frame.kind in ("torque", "limp") else frame.kind


def _put(handle: object, **properties: object) -> None:
    """Set what is not so already: everything that is set is sent."""
    for name, value in properties.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)
