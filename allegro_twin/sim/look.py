"""Pictures of one simulation out of many, for those who look at environments."""

from __future__ import annotations

import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.sim.batch import Snapshot, Worlds
from allegro_twin.sim.render import Camera, Picture


def has_screen() -> bool:
    """Whether a window could be opened at all."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


class Look:
    """Cameras and windows on a batch, made when they are first used. Raises ConfigError where nothing can render."""

    def __init__(self, worlds: Worlds, width: int, height: int) -> None:
        self._worlds, self._size = worlds, (width, height)
        self._camera: Camera | None = None
        self._window: Any = None
        self._seen: Snapshot | None = None

    def colours(self, row: int) -> Picture:
        """Rows, columns, RGB."""
        return self._aimed(row).take()

    def depth(self, row: int) -> NDArray[np.float32]:
        """Rows, columns, m."""
        return self._aimed(row).take_depth()

    def show(self, row: int) -> None:
        """Show it in a window. Raises ConfigError without a screen."""
        if self._window is None:
            if not has_screen():
                raise ConfigError("render_mode 'human' needs a screen; without one use 'rgb_array'")
            from mujoco import viewer

            self._seen = self._worlds.snapshot(row)
            self._window = viewer.launch_passive(self._seen.model, self._seen.data)
        with self._window.lock():
            self._worlds.snapshot(row, self._seen)
        self._window.sync()

    def close(self) -> None:
        if self._camera is not None:
            self._camera.close()
        if self._window is not None:
            self._window.close()
        self._camera = self._window = None

    def _aimed(self, row: int) -> Camera:
        self._seen = self._worlds.snapshot(row, self._seen)
        if self._camera is None:
            width, height = self._size
            self._camera = Camera(self._seen, width=width, height=height)
        return self._camera
