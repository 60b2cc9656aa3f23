"""How the link and the motors are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import viser

from allegro_twin.surfaces.panel.page.bars import health
from allegro_twin.surfaces.panel.stream import Frame

if TYPE_CHECKING:
    from allegro_twin.surfaces.panel.page.parts import Board


class Health:
    """For everybody who looks."""

    def __init__(self, board: Board, gui: viser.GuiApi) -> None:
        opened = board.opened
        assert opened is not None
        self._board, self._spec = board, opened.spec
        self._text = gui.add_html("")

    def refresh(self, frame: Frame) -> None:
        self._text.content = health(self._spec, frame, self._board.history.rate)

    def enable(self, on: bool) -> None:
        """There is nothing to press."""
