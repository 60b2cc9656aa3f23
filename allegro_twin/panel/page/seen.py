"""What the parts of a page may know of it, and what they may ask: the board keeps it, a tab speaks for one browser."""

from __future__ import annotations

from typing import Protocol

from allegro_twin.panel import wishes as w
from allegro_twin.panel.frame import Frame, Notice, Opened, Shelf
from allegro_twin.panel.page.history import History
from allegro_twin.panel.page.reach import Reach
from allegro_twin.panel.wheel import Wheel
from allegro_twin.types import Vector


class Shared(Protocol):
    """What all browsers see alike."""

    wheel: Wheel
    history: History
    shelf: Shelf
    opened: Opened | None
    frame: Frame | None
    reach: Reach | None
    pictures: dict[str, str]
    ended: str
    quiet: bool
    notice: Notice
    gone: str
    ago: float | None
    playing: bool

    @property
    def goal(self) -> Vector:
        """Where the joints were last wished to be, (n,), rad."""
        ...

    def ask(self, who: int, wish: w.Wish) -> None:
        """Pass on what somebody wishes, if they drive."""
        ...

    def look_back(self, ago: float | None) -> None:
        """Draw what was so many seconds ago; None: what is."""
        ...

    def changed(self) -> None:
        """Somebody took the wheel or let go of it."""
        ...

    def release(self, who: int) -> None:
        """Somebody lets go of the wheel."""
        ...


class Own(Protocol):
    """One browser, as its parts see it."""

    who: int

    def ask(self, wish: w.Wish) -> None:
        """Wish for something in its name."""
        ...
