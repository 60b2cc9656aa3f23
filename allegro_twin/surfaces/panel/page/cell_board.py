"""What all browsers see of one cell, and who of them leads it."""

from __future__ import annotations

import threading
from collections.abc import Callable

import viser

from allegro_twin.surfaces.panel import requests as w
from allegro_twin.surfaces.panel.cell import CellFrame, CellOpened, Place
from allegro_twin.surfaces.panel.control_lock import Wheel
from allegro_twin.surfaces.panel.page.cell_scene import CellStage
from allegro_twin.surfaces.panel.page.cell_tab import CellTab
from allegro_twin.surfaces.panel.stream import News, Notice

_EVERY = 5
"""Frames between two looks at the buttons: six a second."""


class CellBoard:
    """Told news and frames, it keeps the tabs of all browsers; what those wish it passes on if they drive."""

    def __init__(self, server: viser.ViserServer, wish: Callable[[w.Wish | Place], None]) -> None:
        self._server, self._wish = server, wish
        self.wheel, self.notice = Wheel(), Notice("")
        self.opened: CellOpened | None = None
        self._frame: CellFrame | None = None
        self._stage: CellStage | None = None
        self._tabs: dict[int, CellTab] = {}
        self._changing, self._count, self._quiet = threading.RLock(), 0, False
        server.on_client_connect(self._come)
        server.on_client_disconnect(self._go)

    def ask(self, who: int, wish: w.Wish | Place) -> None:
        """Pass on what somebody wishes, if they drive."""
        if not self.wheel.drives(who):
            self._tabs[who].tell(Notice("you look on; somebody else drives, or nobody: press Drive", bad=True))
            return
        self.notice = Notice("")
        self._wish(wish)

    def release(self, who: int) -> None:
        """Somebody lets go of the wheel."""
        if self.wheel.let_go(who):
            self._wish(w.Gone())

    def hear(self, news: News | CellOpened) -> None:
        """What the cell's process says."""
        with self._changing:
            if isinstance(news, CellOpened):
                self.opened, self._stage = news, CellStage(self._server, news)
            elif isinstance(news, Notice):
                self.notice = news
                for tab in self._tabs.values():
                    tab.tell(news)

    def show(self, frame: object) -> None:
        """A moment of the cell."""
        with self._changing:
            if self._stage is None or not isinstance(frame, CellFrame):
                return
            if self._quiet:
                self._quiet, self.notice = False, Notice("")
            self._frame = frame
            self._stage.show(frame)
            self._count += 1
            if self._count % _EVERY == 0:
                for tab in self._tabs.values():
                    tab.refresh(frame)

    def silence(self) -> None:
        """No moment came for a second."""
        with self._changing:
            self._quiet, self.notice = True, Notice("No news from the cell for a second", bad=True)
            for tab in self._tabs.values():
                tab.refresh(self._frame)

    def _come(self, client: viser.ClientHandle) -> None:
        with self._changing:
            self.wheel.join(client.client_id)
            self._tabs[client.client_id] = CellTab(self, client)
            self._tabs[client.client_id].refresh(self._frame)

    def _go(self, client: viser.ClientHandle) -> None:
        with self._changing:
            self._tabs.pop(client.client_id, None)
            if self.wheel.leave(client.client_id):
                self._wish(w.Gone())
