"""Pictures of simulations in a batch: colours, depths, or a window; made when the first is asked for."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.sim.batch.cpu import SimBatch, Snapshot
from allegro_twin.viewing.camera import Camera
from allegro_twin.viewing.overlays import Mark, add


def has_screen() -> bool:
    """Whether a window could be opened at all."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


class BatchCamera:
    """Takes pictures of one batch. Raises ConfigError where nothing can be rendered."""

    def __init__(self, worlds: SimBatch, width: int, height: int, *, mode: str) -> None:
        self._worlds, self._size, self._mode = worlds, (width, height), mode
        self._camera: Camera | None = None
        self._window: Any = None
        self._seen: Snapshot | None = None
        self._drawing: set[threading.Thread] = set()

    def take(self, row: int, marks: Sequence[Mark] = ()) -> NDArray[Any] | None:
        """Rows, columns, and RGB bytes, or depths in m as float32, in which nothing is marked; nothing where a window
        shows it."""
        match self._mode:
            case "depth_array":
                return self._aimed(row).take_depth()
            case "human":
                self._show(row, marks)
                return None
            case _:
                return self._aimed(row).take(marks)

    def close(self) -> None:
        if self._camera is not None:
            self._camera.close()
        if self._window is not None:
            self._window.close()
            for thread in self._drawing:
                thread.join()  # At the end of a program GLFW would be terminated under it, and neither would end.
        self._camera = self._window = None

    def _show(self, row: int, marks: Sequence[Mark]) -> None:
        if self._window is None:
            if not has_screen():
                raise ConfigError("render_mode 'human' needs a screen; without one use 'rgb_array'")
            from mujoco import viewer

            self._seen = self._worlds.snapshot(row)
            before = set(threading.enumerate())
            self._window = viewer.launch_passive(self._seen.model, self._seen.data)
            self._drawing = set(threading.enumerate()) - before
        with self._window.lock():
            self._worlds.snapshot(row, self._seen)
            self._window.user_scn.ngeom = 0
            assert self._seen is not None
            add(self._window.user_scn, self._seen.model, marks)
        self._window.sync()

    def _aimed(self, row: int) -> Camera:
        self._seen = self._worlds.snapshot(row, self._seen)
        if self._camera is None:
            width, height = self._size
            self._camera = Camera(self._seen, width=width, height=height)
        return self._camera
