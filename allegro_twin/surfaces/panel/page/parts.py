"""What the parts of a page know of what is above them: of one browser's tab, and of the board that all share."""

from __future__ import annotations

from typing import Protocol

from allegro_twin.surfaces.panel import requests as w
from allegro_twin.surfaces.panel.cell import CellOpened, Place
from allegro_twin.surfaces.panel.control_lock import Wheel
from allegro_twin.surfaces.panel.page.history import History
from allegro_twin.surfaces.panel.page.tip_ik import Reach
from allegro_twin.surfaces.panel.stream import Frame, Notice, Opened, Shelf
from allegro_twin.types import Vector


class Tab(Protocol):
    """`page.tab.Tab`, to those who are in it."""

    who: int

    def ask(self, wish: w.Wish) -> None: ...


class Board(Protocol):
    """`page.board.Board`, to those who show what is on it."""

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
    ago: float | None
    playing: bool

    @property
    def goal(self) -> Vector: ...

    def ask(self, who: int, wish: w.Wish) -> None: ...

    def look_back(self, ago: float | None) -> None: ...

    def changed(self) -> None: ...

    def release(self, who: int) -> None: ...


class CellBoard(Protocol):
    """`page.cell_board.CellBoard`, to those who show what is on it."""

    wheel: Wheel
    opened: CellOpened | None
    notice: Notice

    def ask(self, who: int, wish: w.Wish | Place) -> None: ...

    def release(self, who: int) -> None: ...
