"""What all browsers see of one hand, and who of them drives it."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
import viser

from allegro_twin.surfaces.panel import requests as w
from allegro_twin.surfaces.panel.control_lock import Wheel
from allegro_twin.surfaces.panel.page.client import Tab
from allegro_twin.surfaces.panel.page.history import History
from allegro_twin.surfaces.panel.page.pictures import pictures
from allegro_twin.surfaces.panel.page.scene import Stage
from allegro_twin.surfaces.panel.page.tip_ik import Reach
from allegro_twin.surfaces.panel.stream import Ended, Frame, News, Notice, Opened, Shelf
from allegro_twin.types import Vector

_EVERY = 5
"""Frames between two looks at the buttons and bars: six a second."""


class Board:
    """Told news and frames, it keeps the tabs of all browsers; what those wish it passes on if they drive."""

    def __init__(self, server: viser.ViserServer, wish: Callable[[w.Wish], None], gone: str) -> None:
        self.server, self._wish, self.gone = server, wish, gone
        self.wheel, self.history, self.shelf = Wheel(), History(), Shelf()
        self.opened: Opened | None = None
        self.frame: Frame | None = None
        self.reach: Reach | None = None
        self.pictures: dict[str, str] = {}
        self.ended, self.quiet = "", False
        self.notice = Notice("")
        self.ago: float | None = None
        """How long ago what is drawn was, s; None: it is live."""
        self.playing = False
        self._goal: Vector | None = None
        self._stage: Stage | None = None
        self._tabs: dict[int, Tab] = {}
        self._changing, self._count = threading.RLock(), 0
        server.on_client_connect(self._come)
        server.on_client_disconnect(self._go)

    @property
    def goal(self) -> Vector:
        """Where the joints were last wished to be, (n,), rad: what a further wish begins with."""
        frame = self.frame
        assert frame is not None
        if self._goal is not None:
            return self._goal
        return np.where(np.isnan(frame.target), frame.position, frame.target)

    def ask(self, who: int, wish: w.Wish) -> None:
        """Pass on what somebody wishes, if they drive."""
        if not self.wheel.drives(who):
            self._tabs[who].tell(Notice("you look on; somebody else drives, or nobody: press Drive", bad=True))
            return
        self._goal = np.array(wish.position) if isinstance(wish, w.Joints) else None
        self._wish(wish)

    def hear(self, news: News) -> None:
        """What the hand's process says."""
        with self._changing:
            match news:
                case Opened():
                    self._begin(news)
                case Shelf():
                    self.shelf = news
                    if self.opened is not None:
                        every = {**news.postures, **news.grasps}
                        self.pictures = pictures(self.opened.spec, self.opened.scenery, every)
                    for tab in self._tabs.values():
                        tab.fill()
                case Notice():
                    self.notice = news
                    for tab in self._tabs.values():
                        tab.tell(news)
                case Ended(why):
                    self.ended = why
            self._refresh()

    def show(self, frame: object) -> None:
        """A moment of the hand."""
        with self._changing:
            if (
                not isinstance(frame, Frame)
                or self.opened is None
                or frame.hand != self.opened.hand
                or self._stage is None
            ):
                return
            self.frame, self.quiet = frame, False
            self.history.add(frame)
            self._count += 1
            drawn = self._drawn()
            if drawn is not None:
                self._stage.show(drawn)
            if self._count % _EVERY == 0:
                self._refresh()

    def silence(self) -> None:
        """No moment came for a second."""
        with self._changing:
            if self.frame is not None and not self.quiet:
                self.quiet = True
                self._refresh()

    def look_back(self, ago: float | None) -> None:
        """Draw what was so many seconds ago; None: what is."""
        with self._changing:
            self.ago, self.playing = ago, False
            if ago is not None and self._stage is not None and (frame := self.history.at(ago)) is not None:
                self._stage.show(frame)

    def _drawn(self) -> Frame | None:
        """What to draw now: the newest frame, one of long ago that is as old as ever, or nothing new."""
        if self.ago is None:
            return self.frame
        return self.history.at(self.ago) if self.playing else None

    def changed(self) -> None:
        """Somebody took the wheel or let go of it: tell everybody."""
        with self._changing:
            self._refresh()

    def release(self, who: int) -> None:
        """Somebody lets go of the wheel."""
        if self.wheel.let_go(who):
            self._wish(w.Gone())
        self.changed()

    def _begin(self, opened: Opened) -> None:
        self.opened, self.frame, self.ended, self.ago = opened, None, "", None
        self._goal = None
        self.reach = None if opened.no_tips else Reach(opened.spec)
        self._stage = Stage(self.server, opened)
        for who, tab in list(self._tabs.items()):
            self._tabs[who] = tab.anew()

    def _come(self, client: viser.ClientHandle) -> None:
        with self._changing:
            self.wheel.join(client.client_id)
            self._tabs[client.client_id] = Tab(self, client)
            self._refresh()

    def _go(self, client: viser.ClientHandle) -> None:
        with self._changing:
            self._tabs.pop(client.client_id, None)
            if self.wheel.leave(client.client_id):
                self._wish(w.Gone())
            self._refresh()

    def _refresh(self) -> None:
        for tab in self._tabs.values():
            tab.refresh(self.frame)
