"""The library as buttons below pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import viser

from allegro_twin.surfaces.panel import requests as w
from allegro_twin.surfaces.panel.page.bars import FONT
from allegro_twin.surfaces.panel.stream import Frame

if TYPE_CHECKING:
    from allegro_twin.surfaces.panel.page.parts import Board, Tab

_LETTERS = 30
"""Of the names of pictures that stand side by side; three at most do."""
_ASIDE = "29.5%"
"""viser's room for a label, of which the buttons have none."""


class Shelves:
    """Postures and grasps; what is pressed is done at once."""

    def __init__(self, tab: Tab, board: Board, gui: viser.GuiApi) -> None:
        self._tab, self._board, self._gui = tab, board, gui
        self._folders = [gui.add_folder("Postures"), gui.add_folder("Grasps")]
        self._filled: tuple[object, object] | None = None
        self.fill()

    def fill(self) -> None:
        """With what the library has now."""
        shelf = self._board.shelf
        names = (tuple(shelf.postures), tuple(shelf.grasps))
        if names == self._filled or not self._board.pictures:
            return
        self._filled = names
        wishes: tuple[Callable[[str], w.Wish], ...] = (w.Posture, w.Grasp)
        for folder, entries, wish in zip(self._folders, names, wishes, strict=True):
            for child in list(folder._children.values()):
                child.remove()
            with folder:
                if not entries:
                    self._gui.add_html(f'<div style="{FONT}">none for this hand</div>')
                for row in _rows([self._short(name, entries) for name in entries]):
                    self._row(row, wish)

    def _short(self, name: str, entries: Sequence[str]) -> str:
        short = name.removeprefix(f"{self._model()}_")
        return name if short in entries else short

    def _model(self) -> str:
        """With whose name and `_` what ships for one model of hand begins; the library finds it without."""
        opened = self._board.opened
        return "" if opened is None else opened.spec.model

    def _row(self, names: Sequence[str], wish: Callable[[str], w.Wish]) -> None:
        cell = "flex:1;text-align:center"
        own = f"{self._model()}_"
        pictures = [self._board.pictures.get(name) or self._board.pictures.get(own + name, "") for name in names]
        cells = "".join(f'<div style="{cell}">{picture}</div>' for picture in pictures)
        self._gui.add_html(f'<div style="display:flex;padding:6px 8px 0 {_ASIDE}">{cells}</div>')
        group = self._gui.add_button_group("", names)

        async def pressed(event: Any) -> None:
            self._tab.ask(wish(event.target.value))

        group.on_click(pressed)

    def refresh(self, frame: Frame) -> None:
        """Nothing here changes with time."""

    def enable(self, on: bool) -> None:
        """viser's groups of buttons cannot be disabled; who may not press them is told so."""


def _rows(names: Sequence[str]) -> list[tuple[str, ...]]:
    """As many side by side as their names leave room for."""
    rows: list[list[str]] = [[]]
    for name in names:
        if len(rows[-1]) == 3 or (rows[-1] and len("".join(rows[-1])) + len(name) > _LETTERS):
            rows.append([])
        rows[-1].append(name)
    return [tuple(row) for row in rows if row]
