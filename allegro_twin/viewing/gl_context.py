"""Pictures of MuJoCo scenes without a window, all of a thread's through one OpenGL context.

`mujoco.Renderer` opens a context for each model, in which the driver makes its programs anew: 0.2 s that this saves,
from the second scene on.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.types import Array
from allegro_twin.viewing.overlays import Mark, add


@dataclass(frozen=True, slots=True, eq=False)
class PinholeView:
    """A pinhole in the world. Its axes are the field's for pictures: x right, y down, z ahead."""

    position: Array
    """(3,), m."""
    rotation: Array
    """Its axes in the world, columns of (3, 3)."""
    left: float
    right: float
    up: float
    down: float
    """Where the picture ends at a distance of 1 m ahead, m: left and up are negative."""

    def eye(self) -> mujoco.MjvCamera:
        """A camera of MuJoCo's own from there and along it: what lights go by."""
        eye, ahead = mujoco.MjvCamera(), self.rotation[:, 2]
        eye.distance, eye.lookat = 1.0, self.position + ahead
        eye.azimuth = float(np.degrees(np.arctan2(ahead[1], ahead[0])))
        eye.elevation = float(np.degrees(np.arcsin(np.clip(ahead[2], -1.0, 1.0))))
        return eye

    def onto(self, cameras: Any) -> None:
        """Into the cameras of a scene, one for each eye, whose near and far planes stay."""
        for camera in cameras:
            near = camera.frustum_near
            camera.pos, camera.forward, camera.up = self.position, self.rotation[:, 2], -self.rotation[:, 1]
            camera.frustum_center = near * (self.left + self.right) / 2.0
            camera.frustum_width = near * (self.right - self.left) / 2.0
            camera.frustum_bottom, camera.frustum_top = -near * self.down, -near * self.up


_GEOMS = 10_000  # As many as mujoco.Renderer has room for.
_THREAD = threading.local()


class OffscreenRenderer:
    """What is drawn of one model. Raises what MuJoCo raises where nothing can be rendered; for one thread.

    Not `sites`: without the marks that only programs see.
    """

    def __init__(self, model: mujoco.MjModel, height: int, width: int, *, sites: bool = True) -> None:
        self._model, self._size = model, (height, width)
        self._scene, self._shown = mujoco.MjvScene(model, _GEOMS), mujoco.MjvOption()
        if not sites:
            self._shown.sitegroup[:] = 0
        self._area = mujoco.MjrRect(0, 0, width, height)
        self._context = _context()
        self._context.make_current()
        self._drawing: Any = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150.value)
        self._drawing.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR

    def draw(
        self, data: mujoco.MjData, eye: mujoco.MjvCamera | PinholeView, marks: Sequence[Mark] = ()
    ) -> NDArray[np.uint8]:
        """Rows, columns, RGB."""
        picture = np.empty((*self._size, 3), np.uint8)
        self._draw(data, eye, marks)
        mujoco.mjr_readPixels(picture, None, self._area, self._drawing)
        return np.ascontiguousarray(picture[::-1])

    def draw_depth(self, data: mujoco.MjData, eye: mujoco.MjvCamera | PinholeView) -> NDArray[np.float32]:
        """Rows, columns, m. In the colours of segments, for MuJoCo measures depth more finely without light."""
        nearness = np.empty(self._size, np.float32)
        flags = self._scene.flags.copy()
        for flag in (mujoco.mjtRndFlag.mjRND_SEGMENT, mujoco.mjtRndFlag.mjRND_IDCOLOR):
            self._scene.flags[flag] = True
        self._draw(data, eye)
        mujoco.mjr_readPixels(None, nearness, self._area, self._drawing)
        self._scene.flags[:] = flags
        near, far = (getattr(self._model.vis.map, name) * self._model.stat.extent for name in ("znear", "zfar"))
        depth = near * far / (near + nearness[::-1].astype(np.float64) * (far - near))
        return np.asarray(depth, np.float32)

    def close(self) -> None:
        """What is drawn is forgotten; the context stays for the thread's next scene."""
        if self._drawing is not None:
            self._context.make_current()
            self._drawing.free()
            self._drawing = None

    def _draw(self, data: mujoco.MjData, eye: mujoco.MjvCamera | PinholeView, marks: Sequence[Mark] = ()) -> None:
        self._context.make_current()
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._drawing)
        every = mujoco.mjtCatBit.mjCAT_ALL.value
        own = eye.eye() if isinstance(eye, PinholeView) else eye
        mujoco.mjv_updateScene(self._model, data, self._shown, None, own, every, self._scene)
        if isinstance(eye, PinholeView):
            eye.onto(self._scene.camera)
        add(self._scene, self._model, marks)
        mujoco.mjr_render(self._area, self._scene, self._drawing)


def _context() -> Any:
    """This thread's own; MuJoCo draws into a buffer of its own, so that the size of this one means nothing."""
    if not hasattr(_THREAD, "context"):
        _THREAD.context = mujoco.GLContext(64, 64)
    return _THREAD.context
