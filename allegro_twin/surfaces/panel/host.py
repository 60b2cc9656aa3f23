"""The process of the panel that has the session: it carries out requests of the page, and tells the page about it."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from typing import Protocol, TypeAlias

from allegro_twin.errors import ConfigError, HandError
from allegro_twin.files.first_error import closing_noted
from allegro_twin.surfaces.panel import requests
from allegro_twin.surfaces.panel.page_process import PageProcess, PageServer
from allegro_twin.surfaces.panel.stream import (
    FrameSender,
    LibraryContents,
    Notice,
    SessionEnded,
    SessionInfo,
    StreamFrame,
)

_BEAT = 0.1  # s between two looks at the session and the page.
_SWITCH = 0.0005  # s that a thread may keep the loop's thread waiting; Python's own 5 ms are longer than a period.

_WITHOUT_HAND = (
    requests.StopMotion, requests.ReleaseStop, requests.DriverLeft, requests.MoveJoints, requests.DragObject,
    requests.DropObject,
)  # fmt: skip
"""Requests that are no loss where there is no hand, or come thirty times a second."""

Send: TypeAlias = Callable[[StreamFrame], None]


class Session(Protocol):
    """A hand or a cell that is open for the page. `stop` and `stay` may come from any thread."""

    def describe(self) -> SessionInfo: ...
    def library(self) -> LibraryContents | None: ...
    def execute(self, request: requests.Request) -> str: ...
    def stop(self) -> None: ...
    def stay(self) -> None: ...
    def report(self) -> Iterator[Notice | SessionEnded]: ...
    def close(self) -> str:
        """End it. Returns what the page should know of that; empty: nothing."""
        ...


Opener: TypeAlias = Callable[[int, Send], Session]


class Sessions(Protocol):
    """Opens sessions."""

    def prepare(self, request: requests.OpenScene | requests.Reopen | None) -> Opener:
        """How to open the session as a request has it; None: as it was last. Raises ConfigError."""
        ...


class Host:
    """Serves one session until it is closed. The session is stopped afterwards, whatever happens."""

    def __init__(self, sessions: Sessions, pages: PageServer) -> None:
        self._sessions, self._pages = sessions, pages
        self._requests, self._count = requests.RequestQueue(), 0
        self._session: Session | None = None
        self._over, self._turning = threading.Event(), threading.Thread(target=self._turn, name="panel", daemon=True)
        self._page = pages.open()
        self._send = FrameSender(self._page.frames)

    def serve(self, tell: Callable[[str], None]) -> None:
        """Serve until it is interrupted; `tell` gets the page's address. Raises HandError when the session cannot be
        opened at all, or the page cannot be shown."""
        sys.setswitchinterval(_SWITCH)
        with closing_noted(self):
            self.begin()
            tell(self._page.address())
            while True:
                self.turn()

    def serve_in_background(self) -> str:
        """Serve in a thread, until `close`; the page's address. Raises as `serve` does."""
        self.begin()
        address = self._page.address()
        self._turning.start()
        return address

    def begin(self) -> None:
        """Open the session and listen to the page."""
        self._listen()
        self._open(self._sessions.prepare(None))

    def turn(self) -> None:
        """Carry out the next request, if one comes soon, and look after session and page."""
        request = self._requests.get(_BEAT)
        if request is not None:
            self._execute(request)
        self._watch()

    def close(self) -> None:
        """Close the session and end the page."""
        self._over.set()
        if self._turning.is_alive():
            self._turning.join()
        try:
            self._close()
        finally:
            self._page.close()

    def _turn(self) -> None:
        while not self._over.is_set():
            self.turn()

    def _listen(self) -> None:
        page = self._page
        threading.Thread(target=lambda: self._hear(page), name="requests", daemon=True).start()

    def _hear(self, page: PageProcess) -> None:
        """In a thread of its own: a stop does not wait for a request that is being planned."""
        for request in page.requests():
            self._take(request)
        self._take(requests.DriverLeft())

    def _take(self, request: requests.Request) -> None:
        session, limp = self._session, self._pages.gone == "limp"
        if isinstance(request, requests.IMMEDIATE):
            self._execute(request)
            return
        if isinstance(request, requests.StopMotion) or (isinstance(request, requests.DriverLeft) and limp):
            if session is not None:
                session.stop()
            self._requests.clear()
            request = requests.StopMotion()
        elif isinstance(request, requests.DriverLeft):
            self._requests.clear()
            if session is not None:
                session.stay()
        self._requests.put(request)

    def _execute(self, request: requests.Request) -> None:
        try:
            if isinstance(request, requests.OpenScene | requests.Reopen):
                self._reopen(request)
            elif self._session is None:
                if not isinstance(request, _WITHOUT_HAND):
                    self._page.tell(Notice("there is no hand: open it again first", bad=True))
            else:
                text = self._session.execute(request)
                if text:
                    self._page.tell(Notice(text))
                if isinstance(request, requests.StoreTaught):
                    _tell_library(self._page, self._session)
        except HandError as error:
            self._page.tell(Notice(str(error), bad=True))

    def _watch(self) -> None:
        """Tell the page what the session reports, and open a new page where it has died."""
        if not self._page.alive:
            self._page.close()
            self._page = self._pages.open()
            self._send = FrameSender(self._page.frames)
            self._listen()
            if self._session is not None:
                self._introduce(self._session)
        for message in self._session.report() if self._session is not None else ():
            self._page.tell(message)
            if isinstance(message, SessionEnded):
                self._close()

    def _reopen(self, request: requests.OpenScene | requests.Reopen) -> None:
        """Open the session anew; as it was, where this one cannot be opened."""
        start = self._sessions.prepare(request)
        self._close()
        try:
            self._open(start)
        except ConfigError:
            self._open(self._sessions.prepare(None))
            raise

    def _open(self, start: Opener) -> None:
        self._count += 1
        self._session = start(self._count, lambda frame: self._send(frame))
        self._introduce(self._session)

    def _introduce(self, session: Session) -> None:
        page = self._page
        page.tell(session.describe())
        # Some hundred files are read for it: nobody should wait for them to see the hand.
        threading.Thread(target=lambda: _tell_library(page, session), name="library", daemon=True).start()

    def _close(self) -> None:
        session, self._session = self._session, None
        if session is not None and (text := session.close()):
            self._page.tell(Notice(text))


def _tell_library(page: PageProcess, session: Session) -> None:
    try:
        if (contents := session.library()) is not None:
            page.tell(contents)
    except HandError as error:
        page.tell(Notice(f"the library: {error}", bad=True))
