"""Where in a camera's picture a model shows that is drawn alone: what a camera on a machine sees of the machine."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.cell.camera.camera import Camera
from allegro_twin.cell.camera.settings import CameraSettings
from allegro_twin.types import Array

AROUND = 4
"""Pixels: by so many it is taken larger on every side, for a camera's edges are not exact."""


class Alone:
    """A model without surroundings. For one thread; `close` it. Raises ConfigError where nothing can be rendered."""

    def __init__(self, model: mujoco.MjModel, settings: CameraSettings) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._camera = Camera(model, settings)

    def seen(self, pose: Callable[[Array], None]) -> NDArray[np.bool_]:
        """Which pixels show it, (rows, columns), once `pose` has written its joints into `qpos`."""
        pose(self._data.qpos)
        mujoco.mj_kinematics(self._model, self._data)
        settings = self._camera.settings
        shown = self._camera.exact(self._data, settings.mount.pose(self._model, self._data)) < settings.furthest
        for axis in (0, 1):
            wide = shown.copy()
            for step in range(1, AROUND + 1):
                ahead, behind = [slice(None)] * 2, [slice(None)] * 2
                ahead[axis], behind[axis] = slice(step, None), slice(None, -step)
                wide[tuple(ahead)] |= shown[tuple(behind)]
                wide[tuple(behind)] |= shown[tuple(ahead)]
            shown = wide
        return np.asarray(shown)

    def close(self) -> None:
        """Idempotent."""
        self._camera.close()
