"""Pictures of simulations in a batch: colours, depths, or a window; made when the first is asked for."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import CommandError, ConfigError
from allegro_twin.sim.batch.shared_model import SharedModelBatch, Snapshot
from allegro_twin.spec import HandSpec
from allegro_twin.viewing.camera import Camera
from allegro_twin.viewing.overlays import Mark, add


def has_screen() -> bool:
    """Whether a window could be opened at all."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


class BatchScene:
    """One simulation of a batch as a scene, as it is whenever it is looked at."""

    def __init__(self, worlds: SharedModelBatch, row: int) -> None:
        self._worlds, self._row, self._seen = worlds, row, worlds.snapshot(row)

    @property
    def spec(self) -> HandSpec:
        return self._seen.spec

    @property
    def model(self) -> mujoco.MjModel:
        return self._seen.model

    @property
    def data(self) -> mujoco.MjData:
        return self._worlds.snapshot(self._row, self._seen).data


class BatchCamera:
    """Takes pictures of one batch. Raises ConfigError where nothing can be rendered."""

    def __init__(self, worlds: SharedModelBatch, width: int, height: int, *, mode: str) -> None:
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


RGB, DEPTH = "rgb", "depth"
FURTHEST = 10.0
"""m. What is farther from a camera, or nothing at all, is so far in its depths."""


class PictureSensor:
    """Pictures of every simulation of a batch from several views, as observations: without marks of goals, which no
    camera sees, and without shadows. Raises ConfigError for an unknown view, and where nothing can be rendered."""

    def __init__(
        self, worlds: SharedModelBatch, width: int, height: int, *, views: Sequence[str], kinds: Sequence[str]
    ) -> None:
        self._worlds, self._size, self._kinds, self._closed = worlds, (height, width), kinds, False
        # Of the scene as it is built, so that no draw moves a camera.
        self._seen = worlds.snapshot(0)
        self._cameras: dict[str, Camera] = {}
        try:
            for each in views:
                self._cameras[each] = Camera(self._seen, width=width, height=height, view=each, shadows=False)
        except ConfigError:
            self.close()
            raise

    def shapes(self) -> dict[str, tuple[tuple[int, ...], type[np.generic], float]]:
        """Shape, type and largest number of each picture of one simulation, by its name."""
        kinds: dict[str, tuple[tuple[int, ...], type[np.generic], float]] = {
            RGB: ((*self._size, 3), np.uint8, 255),
            DEPTH: (self._size, np.float32, FURTHEST),
        }
        return {self._name(kind, view): kinds[kind] for kind in self._kinds for view in self._cameras}

    def take(self) -> dict[str, NDArray[Any]]:
        """All pictures, new arrays: `rgb` (n, rows, columns, 3), bytes, and `depth` (n, rows, columns), m, of one
        camera; of several with the name of each, `rgb_side`. Those of a simulation that has diverged are zeros.
        Raises CommandError once closed."""
        if self._closed:
            raise CommandError("the environment is closed, and takes no more pictures: make a new one")
        n = len(self._worlds.position)
        found = {name: np.zeros((n, *shape), kind) for name, (shape, kind, _) in self.shapes().items()}
        for row in np.flatnonzero(np.isfinite(self._worlds.position).all(axis=-1)).tolist():
            self._worlds.snapshot(row, self._seen)
            for view, camera in self._cameras.items():
                if RGB in self._kinds:
                    found[self._name(RGB, view)][row] = camera.take()
                if DEPTH in self._kinds:
                    found[self._name(DEPTH, view)][row] = np.minimum(camera.take_depth(), FURTHEST)
        return found

    def close(self) -> None:
        self._closed = True
        for camera in self._cameras.values():
            camera.close()

    def _name(self, kind: str, view: str) -> str:
        return kind if len(self._cameras) == 1 else f"{kind}_{view}"
