"""The library: postures and grasps with pictures of the hand, and a field to search them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from allegro_twin.surfaces.panel import requests
from allegro_twin.surfaces.panel.page.html import FONT
from allegro_twin.surfaces.panel.page.page_state import Browser
from allegro_twin.surfaces.panel.stream import StreamFrame

_ROW, _LETTERS = 4, 34
"""Pictures that stand side by side at most, and letters of their names."""


class LibraryView:
    """An entry that is pressed is performed at once."""

    def __init__(self, browser: Browser) -> None:
        self._browser, self._gui = browser, browser.client.gui
        self._search = self._gui.add_text("Search", "", hint="Words of a name: pinch index")
        self._search.on_update(self._searched)
        self._folders = [self._gui.add_folder("Postures"), self._gui.add_folder("Grasps")]
        self._filled: tuple[object, ...] = ()
        self.fill()

    def fill(self) -> None:
        """Show the entries that the library has now, as far as they match the search."""
        library, pictures = self._browser.state.library, self._browser.state.thumbnails
        names = [tuple(filter(self._matches, entries)) for entries in (library.postures, library.grasps)]
        shown = (*names, len(pictures))
        if shown == self._filled:
            return
        self._filled = shown
        makers: tuple[Callable[[str], requests.Request], ...] = (requests.MoveToPosture, requests.PerformGrasp)
        for folder, entries, make in zip(self._folders, names, makers, strict=True):
            for child in list(folder._children.values()):
                child.remove()
            with folder:
                if not entries:
                    text = "none with such a name" if self._search.value.strip() else "none for this hand"
                    self._gui.add_html(f'<div style="{FONT}">{text}</div>')
                for row in rows([self._short(name, entries) for name in entries]):
                    self._row(row, make)

    def _matches(self, name: str) -> bool:
        return all(word in name.lower() for word in self._search.value.lower().replace("_", " ").split())

    def _short(self, name: str, entries: Sequence[str]) -> str:
        """Without the hand's name in front, without which the library finds it, too."""
        short = name.removeprefix(f"{self._browser.info.spec.model}_")
        return name if short in entries else short

    def _row(self, names: Sequence[str], make: Callable[[str], requests.Request]) -> None:
        pictures, own = self._browser.state.thumbnails, f"{self._browser.info.spec.model}_"
        cells = "".join(f"<div>{pictures.get(name) or pictures.get(own + name, '')}</div>" for name in names)
        self._gui.add_html(f'<div class="library-row">{cells}</div>')
        group = self._gui.add_button_group("", names)

        async def pressed(event: Any) -> None:
            self._browser.ask(make(event.target.value))

        group.on_click(pressed)

    async def _searched(self, event: Any) -> None:
        self.fill()

    def refresh(self, frame: StreamFrame) -> None:
        """Nothing here changes with time."""

    def enable(self, on: bool) -> None:
        """viser's groups of buttons cannot be disabled; who may not press them is told so."""


def rows(names: Sequence[str]) -> list[tuple[str, ...]]:
    """As many side by side as their names leave room for."""
    found: list[list[str]] = [[]]
    for name in names:
        if len(found[-1]) == _ROW or (found[-1] and len("".join(found[-1])) + len(name) > _LETTERS):
            found.append([])
        found[-1].append(name)
    return [tuple(row) for row in found if row]
