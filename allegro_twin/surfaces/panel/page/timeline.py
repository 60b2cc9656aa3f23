"""What was and what will be kept: recording, looking back, and teaching."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import viser

from allegro_twin.surfaces.panel import requests as w
from allegro_twin.surfaces.panel.page.bars import banner
from allegro_twin.surfaces.panel.page.history import SECONDS
from allegro_twin.surfaces.panel.stream import Frame

if TYPE_CHECKING:
    from allegro_twin.surfaces.panel.page.parts import Board, Tab


class Timeline:
    """The pictures of the last minute are kept in the page; a recording is a file beside the hand."""

    def __init__(self, tab: Tab, board: Board, gui: viser.GuiApi) -> None:
        self._tab, self._board = tab, board
        self._recording = self._teaching = False
        with gui.add_folder("Record"):
            self._record = gui.add_button("Record", icon=viser.Icon.PLAYER_RECORD)
            self._said = gui.add_html("")
        with gui.add_folder("Look back"):
            self._pause = gui.add_button("Pause the picture", icon=viser.Icon.PLAYER_PAUSE, hint="The hand goes on")
            self._back = gui.add_slider("s ago", 0.0, SECONDS, 0.1, 0.0, visible=False)
            self._play = gui.add_button("Play from there", icon=viser.Icon.PLAYER_PLAY, visible=False)
        with gui.add_folder("Teach"):
            carried = board.opened is not None and "gravity" in board.opened.kinds
            how = "Gravity compensation: lead the fingers" if carried else "The motors let go: lead the fingers"
            self._teach = gui.add_button("Teach", hint=how)
            self._repeat = gui.add_button("Repeat what was shown")
            self._name = gui.add_text("Name", "mine", hint="In the library")
            self._keep = gui.add_button_group("Store the", ("posture", "motion"))
        self._wire()

    def _wire(self) -> None:
        async def record(event: Any) -> None:
            self._tab.ask(w.Record(not self._recording))

        async def teach(event: Any) -> None:
            self._tab.ask(w.Teach(not self._teaching))

        async def repeat(event: Any) -> None:
            self._tab.ask(w.Repeat())

        async def keep(event: Any) -> None:
            self._tab.ask(w.Keep(self._name.value.strip(), event.target.value == "motion"))

        self._record.on_click(record)
        self._teach.on_click(teach)
        self._repeat.on_click(repeat)
        self._keep.on_click(keep)
        self._pause.on_click(self._paused)
        self._back.on_update(self._scrubbed)
        self._play.on_click(self._played)

    def refresh(self, frame: Frame) -> None:
        self._recording, self._teaching = frame.recorded >= 0.0, frame.teaching
        _put(self._record, label="End the recording" if self._recording else "Record")
        _put(self._teach, label="Done" if self._teaching else "Teach")
        text = banner([("#c8102e", f"recording: {frame.recorded:.0f} s")]) if self._recording else ""
        _put(self._said, content=text)
        back = self._board.ago is not None
        _put(self._pause, label="Back to now" if back else "Pause the picture")
        _put(self._back, visible=back)
        _put(self._play, visible=back)

    def enable(self, on: bool) -> None:
        for each in (self._record, self._pause, self._back, self._play, self._teach, self._repeat):
            each.disabled = not on

    async def _paused(self, event: Any) -> None:
        if self._board.wheel.drives(self._tab.who):
            self._board.look_back(0.0 if self._board.ago is None else None)

    async def _scrubbed(self, event: Any) -> None:
        if event.client_id is not None and self._board.wheel.drives(self._tab.who):
            self._board.look_back(float(event.target.value))

    async def _played(self, event: Any) -> None:
        self._board.playing = self._board.wheel.drives(self._tab.who)


def _put(handle: Any, **properties: object) -> None:
    for name, value in properties.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)
