"""The process that has the hand: it opens it, does what is wished, and tells the page."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from allegro_twin.app.config import RunConfig
from allegro_twin.errors import ConfigError, HandError
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.panel import requests as w
from allegro_twin.surfaces.panel.cell import Place
from allegro_twin.surfaces.panel.commands import Doing
from allegro_twin.surfaces.panel.description import described, scene_of, shelf
from allegro_twin.surfaces.panel.page_process import Page, Pages
from allegro_twin.surfaces.panel.session import OpenHand
from allegro_twin.surfaces.panel.stream import Ended, Notice, Sender

_BEAT = 0.1  # s between two looks at what the hand has to say.
_TURNS = 0.0005  # s that a thread may keep the loop's thread waiting; Python's own 5 ms are longer than a period.


@dataclass(frozen=True, slots=True)
class Habits:
    """How the panel deals with the hand."""

    gone: Literal["hold", "limp"] = "hold"
    """What the hand does when nobody drives any more."""
    recordings: Path = Path("out")
    library: Path = Path("library/taught.yaml")


class Host:
    """Serves one hand until it is interrupted. The hand is limp afterwards, whatever happens."""

    def __init__(self, config: RunConfig, habits: Habits, pages: Pages) -> None:
        self._config, self._habits, self._pages = config, habits, pages
        self._wishes, self._count = w.Wishes(), 0
        self._opened: OpenHand | None = None
        self._doing: Doing | None = None
        self._stalled: HandError | None = None
        self._clipped = 0
        self._page = pages.open()
        self._send = Sender(self._page.frames)

    def serve(self, tell: Callable[[str], None]) -> None:
        """Raises HandError when the hand cannot be opened at all, or the page cannot be shown."""
        sys.setswitchinterval(_TURNS)
        try:
            self.begin()
            tell(self._page.address())
            while True:
                self.turn()
        finally:
            self.close()

    def begin(self) -> None:
        """Open the hand and listen to the page."""
        self._listen()
        self._open(self._config, perform=False)

    def turn(self) -> None:
        """Do the next wish, if one comes soon, and look after hand and page."""
        wish = self._wishes.get(_BEAT)
        if wish is not None:
            self._do(wish)
        self._look()

    def close(self) -> None:
        """Leave the hand limp and end the page."""
        try:
            self._close()
        finally:
            self._page.close()

    def _listen(self) -> None:
        page = self._page
        threading.Thread(target=lambda: self._hear(page), name="wishes", daemon=True).start()

    def _hear(self, page: Page) -> None:
        """In a thread of its own: a stop does not wait for a wish that is being planned."""
        for wish in page.wishes():
            if not isinstance(wish, Place):  # That is of a cell.
                self._take(wish)
        self._take(w.Gone())

    def _take(self, wish: w.Wish) -> None:
        opened, limp = self._opened, self._habits.gone == "limp"
        if isinstance(wish, w.Stop) or (isinstance(wish, w.Gone) and limp):
            if opened is not None:
                opened.hand.direct.limp()
            self._wishes.clear()
            wish = w.Stop()
        elif isinstance(wish, w.Gone):
            self._wishes.clear()
            if opened is not None:
                _stay(opened)
        self._wishes.put(wish)

    def _do(self, wish: w.Wish) -> None:
        try:
            if isinstance(wish, w.Scene):
                self._change(scene_of(self._config, wish), perform=wish.perform)
            elif isinstance(wish, w.Again):
                self._change(self._config, perform=False)
            elif self._doing is not None:
                said = self._doing(wish)
                if said:
                    self._page.tell(Notice(said))
                if isinstance(wish, w.Keep):
                    _stock(self._page, self._doing.spec)
        except HandError as error:
            self._page.tell(Notice(str(error), bad=True))

    def _look(self) -> None:
        """What the hand has to say of itself, and whether the page is still there."""
        if not self._page.alive:
            self._page.close()
            self._page = self._pages.open()
            self._send = Sender(self._page.frames)
            self._listen()
            if self._opened is not None:
                self._introduce(self._opened)
        opened = self._opened
        if opened is None:
            return
        stalled = opened.hand.stalled
        if stalled is not None and stalled is not self._stalled:
            self._page.tell(Notice(str(stalled), bad=True))
        self._stalled = stalled
        if opened.hand.clipped != self._clipped:
            self._clipped = opened.hand.clipped
            if self._clipped:
                self._page.tell(Notice(f"{self._clipped} wishes a little beyond a limit were clipped to it"))
        if opened.trouble:
            self._page.tell(Notice(opened.trouble, bad=True))
            opened.trouble = ""
        if opened.verdict_due and opened.rig.trial is not None:
            opened.verdict_due = False
            report = opened.rig.trial.report()
            words = "held" if report.held else f"not held: {report.reason}"
            self._page.tell(Notice(f"the verdict: {words}", bad=not report.held))
        try:
            _ = opened.hand.state
        except HandError as error:
            self._page.tell(Ended(str(error)))
            self._close()

    def _change(self, config: RunConfig, *, perform: bool) -> None:
        """Open the hand anew; as it was, where this one cannot be opened."""
        before = self._config
        self._close()
        try:
            self._open(config, perform=perform)
            self._config = config
        except ConfigError:
            self._open(before, perform=False)
            raise

    def _open(self, config: RunConfig, *, perform: bool) -> None:
        self._count += 1
        opened = OpenHand(self._count, config, lambda frame: self._send(frame), perform=perform)
        self._opened = opened
        self._doing = Doing(opened, self._habits.recordings, self._habits.library)
        self._introduce(opened)

    def _introduce(self, opened: OpenHand) -> None:
        page, spec = self._page, opened.rig.spec
        page.tell(described(opened))
        # Some hundred files are read for it: nobody should wait for them to see the hand.
        threading.Thread(target=lambda: _stock(page, spec), name="shelf", daemon=True).start()

    def _close(self) -> None:
        opened, self._opened, self._doing = self._opened, None, None
        if opened is not None:
            opened.close()


def _stock(page: Page, spec: HandSpec) -> None:
    try:
        page.tell(shelf(spec))
    except HandError as error:
        page.tell(Notice(f"the library: {error}", bad=True))


def _stay(opened: OpenHand) -> None:
    try:
        opened.hand.direct.stay()
    except HandError:
        pass  # The loop has ended, and the hand is limp; `_look` tells.
