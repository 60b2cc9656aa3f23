"""State of the page that all browsers share: the session, its newest minute, and who drives."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from allegro_twin.surfaces.panel.requests import IMMEDIATE, DriverLeft, Request
from allegro_twin.surfaces.panel.stream import LibraryContents, Notice, SessionInfo, StreamFrame
from allegro_twin.surfaces.panel.tip_ik import TipIK
from allegro_twin.types import Array, Vector

if TYPE_CHECKING:
    import viser

PAUSE = 3
"""Refreshes for which what was touched is left to the person: half a second."""
SECONDS = 60.0
"""Seconds of the session's clock that are kept."""


class ControlLock:
    """Lock of control: one browser drives, and never two. The first drives. Who leaves lets go; then nobody drives
    until somebody takes over or, alone, comes back. Any thread may ask."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._present: list[int] = []
        self._driver: int | None = None

    @property
    def driver(self) -> int | None:
        """Who drives; None: nobody."""
        return self._driver

    @property
    def count(self) -> int:
        """How many browsers there are."""
        return len(self._present)

    def drives(self, who: int) -> bool:
        return self._driver == who

    def join(self, who: int) -> bool:
        """A browser came: whether it drives."""
        with self._lock:
            self._present.append(who)
            if self._driver is None and len(self._present) == 1:
                self._driver = who
            return self._driver == who

    def leave(self, who: int) -> bool:
        """A browser left: whether it drove."""
        with self._lock:
            if who in self._present:
                self._present.remove(who)
            return self._release(who)

    def take(self, who: int) -> bool:
        """A browser wants to drive: whether it does now. Nobody is displaced."""
        with self._lock:
            if self._driver is None and who in self._present:
                self._driver = who
            return self._driver == who

    def let_go(self, who: int) -> bool:
        """A browser wants no longer to drive: whether it drove."""
        with self._lock:
            return self._release(who)

    def _release(self, who: int) -> bool:
        if self._driver != who:
            return False
        self._driver = None
        return True


class FrameHistory:
    """Frames of one opening of a session, the newest minute of them, oldest first."""

    def __init__(self) -> None:
        self._frames: deque[StreamFrame] = deque()

    def add(self, frame: StreamFrame) -> None:
        """A frame of another opening, or of a clock that began anew, forgets those before it."""
        if self._frames and (self._frames[-1].session != frame.session or frame.t <= self._frames[-1].t):
            self._frames.clear()
        self._frames.append(frame)
        while self._frames[0].t < frame.t - SECONDS:
            self._frames.popleft()

    @property
    def span(self) -> float:
        """How far back it goes, s."""
        return self._frames[-1].t - self._frames[0].t if self._frames else 0.0

    @property
    def rate(self) -> float:
        """Frames a second of the session's clock; 0 while there are too few to say."""
        return (len(self._frames) - 1) / self.span if self.span > 0.0 else 0.0

    def at(self, ago: float) -> StreamFrame | None:
        """The frame so many seconds before the newest, or the nearest that there is."""
        if not self._frames:
            return None
        t = self._frames[-1].t - ago
        return min(self._frames, key=lambda frame: abs(frame.t - t))

    def rows(self, seconds: float, most: int) -> tuple[Vector, Array, Array, Array]:
        """The newest `seconds`: times, (k,), s, and positions, targets and torques, (k, n); at most so many rows."""
        frames = [frame for frame in self._frames if frame.t >= self._frames[-1].t - seconds]
        frames = frames[:: max(len(frames) // most, 1)] or list(self._frames)[-1:]
        columns = [np.array([getattr(frame, name) for frame in frames]) for name in ("position", "target", "torque")]
        return np.array([frame.t for frame in frames]), columns[0], columns[1], columns[2]


class PageState:
    """State of every browser's page. `send` passes requests on to the session."""

    def __init__(self, send: Callable[[Request], None]) -> None:
        self._send = send
        self.lock, self.history, self.library = ControlLock(), FrameHistory(), LibraryContents()
        self.thumbnails: dict[str, str] = {}
        """Pictures of postures and grasps by name, as HTML."""
        self.info: SessionInfo | None = None
        self.frame: StreamFrame | None = None
        """The newest."""
        self.tip_ik: TipIK | None = None
        self.ended, self.silent = "", False
        self.notice = Notice("")
        self.shown: StreamFrame | None = None
        """An earlier frame that is drawn; None: the newest is."""
        self.playing = False
        """Earlier frames go by."""
        self.redraw: Callable[[StreamFrame], None] = lambda frame: None

    def open(self, info: SessionInfo) -> None:
        """Another session was opened."""
        self.info, self.frame, self.ended, self.shown, self.playing = info, None, "", None, False
        self.tip_ik = TipIK(info.spec) if info.arm is None and not info.no_tips else None

    def request(self, request: Request) -> None:
        """Pass a request on."""
        if not isinstance(request, IMMEDIATE):
            self.notice = Notice("")
        self._send(request)

    def let_go(self, who: int, *, left: bool = False) -> None:
        """A browser drives no longer; `left`: it is gone."""
        if self.lock.leave(who) if left else self.lock.let_go(who):
            self._send(DriverLeft())

    @property
    def age(self) -> float:
        """How old the picture is, s of the session's clock."""
        return 0.0 if self.shown is None or self.frame is None else self.frame.t - self.shown.t

    def look_back(self, ago: float | None) -> None:
        """Draw the moment so many seconds ago, and stay there; None: draw the newest again."""
        self.playing = False
        self.shown = None if ago is None else self.history.at(ago)
        if self.shown is not None:
            self.redraw(self.shown)

    def add(self, frame: StreamFrame) -> StreamFrame | None:
        """Keep a new frame; the one to draw, if any."""
        before, self.frame, self.silent = self.frame, frame, False
        self.history.add(frame)
        if self.shown is None or before is None:
            return frame
        if not self.playing:
            return None
        self.shown = self.history.at(before.t - self.shown.t)
        return self.shown


@dataclass(frozen=True, slots=True)
class Browser:
    """One browser, for the sections of its page."""

    state: PageState
    client: viser.ClientHandle
    ask: Callable[[Request], None]
    """Pass a request on, if this browser drives."""

    @property
    def drives(self) -> bool:
        return self.state.lock.drives(self.client.client_id)

    @property
    def info(self) -> SessionInfo:
        """Information on the session, which is open whenever there are sections."""
        assert self.state.info is not None
        return self.state.info


class Section(Protocol):
    """A part of one browser's page."""

    def refresh(self, frame: StreamFrame) -> None:
        """Show a moment, some six times a second."""
        ...

    def enable(self, on: bool) -> None:
        """Take requests, or not."""
        ...


def update(handle: object, **properties: object) -> None:
    """Set properties of a viser handle that differ: everything that is set is sent."""
    for name, value in properties.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)
