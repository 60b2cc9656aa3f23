"""Recording, looking back, and teaching."""

from __future__ import annotations

from typing import Any

import viser

from allegro_twin.surfaces.panel import requests
from allegro_twin.surfaces.panel.page.html import BAD, banner
from allegro_twin.surfaces.panel.page.page_state import SECONDS, Browser, update
from allegro_twin.surfaces.panel.stream import StreamFrame


class Timeline:
    """The pictures of the last minute are kept in the page; a recording is a file beside the hand."""

    def __init__(self, browser: Browser) -> None:
        self._browser, gui = browser, browser.client.gui
        self._recording = self._teaching = False
        with gui.add_folder("Record"):
            self._record = gui.add_button("Record", icon=viser.Icon.PLAYER_RECORD)
            self._recorded = gui.add_html("")
        with gui.add_folder("Look back"):
            self._pause = gui.add_button("Pause the picture", icon=viser.Icon.PLAYER_PAUSE, hint="The hand goes on")
            self._back = gui.add_slider("s ago", 0.0, SECONDS, 0.1, 0.0, visible=False)
            self._play = gui.add_button("Play from there", icon=viser.Icon.PLAYER_PLAY, visible=False)
        with gui.add_folder("Teach"):
            carried = "gravity" in browser.info.kinds
            how = "Gravity compensation: lead the fingers" if carried else "The motors let go: lead the fingers"
            self._teach = gui.add_button("Teach", hint=how)
            self._repeat = gui.add_button("Repeat what was shown")
            self._name = gui.add_text("Name", "mine", hint="In the library")
            self._replace = gui.add_checkbox("Replace", initial_value=False, hint="What the library has of that name")
            self._store = gui.add_button_group("Store the", ("posture", "motion"))
        self._wire()

    def _wire(self) -> None:
        ask = self._browser.ask

        async def record(event: Any) -> None:
            ask(requests.Record(not self._recording))

        async def teach(event: Any) -> None:
            ask(requests.Teach(not self._teaching))

        async def repeat(event: Any) -> None:
            ask(requests.PlayTaught())

        async def store(event: Any) -> None:
            what = requests.StoreTaught(self._name.value.strip(), event.target.value == "motion", self._replace.value)
            self._replace.value = False  # Asked for each time.
            ask(what)

        self._record.on_click(record)
        self._teach.on_click(teach)
        self._repeat.on_click(repeat)
        self._store.on_click(store)
        self._pause.on_click(self._on_pause)
        self._back.on_update(self._on_scrub)
        self._play.on_click(self._on_play)

    def refresh(self, frame: StreamFrame) -> None:
        self._recording, self._teaching = frame.recorded >= 0.0, frame.teaching
        update(self._record, label="End the recording" if self._recording else "Record")
        update(self._teach, label="Done" if self._teaching else "Teach")
        text = banner([(BAD, f"recording: {frame.recorded:.0f} s")]) if self._recording else ""
        update(self._recorded, content=text)
        back = self._browser.state.shown is not None
        update(self._pause, label="Back to now" if back else "Pause the picture")
        update(self._back, visible=back)
        update(self._play, visible=back)
        self._enable_what_moves_nothing()

    def enable(self, on: bool) -> None:
        for each in (self._teach, self._repeat):
            each.disabled = not on
        self._enable_what_moves_nothing()

    def _enable_what_moves_nothing(self) -> None:
        """After a stop, too: what led to it is to be kept and looked at."""
        drives, ended = self._browser.drives, bool(self._browser.state.ended)
        update(self._record, disabled=not drives or ended)
        for each in (self._pause, self._back, self._play):
            update(each, disabled=not drives)

    async def _on_pause(self, event: Any) -> None:
        if self._browser.drives:
            self._browser.state.look_back(0.0 if self._browser.state.shown is None else None)

    async def _on_scrub(self, event: Any) -> None:
        if event.client_id is not None and self._browser.drives:
            self._browser.state.look_back(float(event.target.value))

    async def _on_play(self, event: Any) -> None:
        self._browser.state.playing = self._browser.drives
