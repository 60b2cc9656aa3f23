"""Pictures of simulations in a batch: colours, depths, or a window; made when the first is asked for."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from allegro_twin.sim.batch import Worlds
from allegro_twin.sim.look import Look


class Pictures:
    """Takes pictures of one batch. Raises ConfigError where nothing can be rendered."""

    def __init__(self, worlds: Worlds, width: int, height: int, *, mode: str) -> None:
        self._look, self._mode = Look(worlds, width, height), mode

    def take(self, row: int) -> NDArray[Any] | None:
        """Rows, columns, and RGB bytes, or depths in m as float32; nothing where a window shows it."""
        match self._mode:
            case "depth_array":
                return self._look.depth(row)
            case "human":
                self._look.show(row)
                return None
            case _:
                return self._look.colours(row)

    def close(self) -> None:
        self._look.close()
