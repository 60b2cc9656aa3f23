"""Pictures of MuJoCo scenes without a window, all of a thread's through one OpenGL context.

`mujoco.Renderer` opens a context for each model, in which the driver makes its programs anew: 0.2 s that this saves,
from the second scene on.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.types import Array
from allegro_twin.viewing.overlays import Mark, add
from allegro_twin.viewing.views import LARGEST


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


_MORE_GEOMS = 1000  # Room for marks, and for what MuJoCo adds to a model's own shapes.
_FINE = 3
"""Pixels that are rendered for every two of a smooth picture, each way. Multisampling, MuJoCo's default, does not
smooth the edges of shadows, and costs more where no GPU draws."""
_SHADOW_MAP, TO_LIGHT, _CUTOFF = 1024, 1.5, 45.0
"""Pixels of the map of shadows, each way; m to the scene's spotlight, and degrees of its cone."""
_THREAD = threading.local()
_OPENED = threading.Event()
_INHERITED = threading.Event()
"""Whether this process has opened a context; whether it is a fork of one that had."""


def _after_fork() -> None:
    """Drivers draw in threads, which a fork does not take along: whoever draws in it waits for ever, also in a context
    of its own."""
    if _OPENED.is_set() or getattr(sys.modules.get("mujoco.egl"), "EGL_DISPLAY", None) is not None:
        _INHERITED.set()


os.register_at_fork(after_in_child=_after_fork)


class OffscreenRenderer:
    """Offscreen renderer of one model. Raises what MuJoCo raises where nothing can be rendered. For the thread that
    made it: elsewhere, and in a fork of a process that has rendered, all that draws raises ConfigError.

    Not `sites`: without the marks that only programs see. With `shadows`, m around the middle of the scene, pictures
    are smooth, and there are shadows only so far.
    """

    def __init__(
        self, model: mujoco.MjModel, height: int, width: int, *, sites: bool = True, shadows: float = 0.0
    ) -> None:
        self._model, self._size = model, (height, width)
        smooth = shadows > 0.0 and height % 2 == width % 2 == 0 and _FINE * max(height, width) <= 2 * LARGEST
        self._fine = _FINE if smooth else 2
        self._scene, self._shown = (
            mujoco.MjvScene(model, 2 * (model.ngeom + model.nsite) + _MORE_GEOMS),
            mujoco.MjvOption(),
        )
        if not sites:
            self._shown.sitegroup[:] = 0
        self._area = mujoco.MjrRect(0, 0, width, height)
        self.key_light: tuple[Array, Array] | None = None
        """Place (m) and direction of the spotlight in pictures, (3,) each, world; None: as the scene has it."""
        self._context = _context()
        self._context.make_current()
        with _quality(model, self._fine * height // 2, self._fine * width // 2, shadows if smooth else 0.0):
            self._drawing: Any = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150.value)
        self._drawing.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR

    def omit_shadows(self) -> None:
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0

    def draw(
        self, data: mujoco.MjData, eye: mujoco.MjvCamera | PinholeView, marks: Sequence[Mark] = ()
    ) -> NDArray[np.uint8]:
        """Rows, columns, RGB."""
        height, width = (self._fine * edge // 2 for edge in self._size)
        picture = np.empty((height, width, 3), np.uint8)
        area = mujoco.MjrRect(0, 0, width, height)
        self._draw(data, eye, area, marks)
        mujoco.mjr_readPixels(picture, None, area, self._drawing)
        return np.ascontiguousarray(_averaged(picture, self._fine)[::-1])

    def draw_segments(self, data: mujoco.MjData, eye: mujoco.MjvCamera, edge: int) -> NDArray[np.int32]:
        """The number of the geom in each of `edge` rows and columns, at most the picture's; -1 where there is none."""
        area = mujoco.MjrRect(0, 0, edge, edge)
        seen = np.empty((edge, edge, 3), np.uint8)
        with self._as_segments():
            self._draw(data, eye, area)
            mujoco.mjr_readPixels(seen, None, area, self._drawing)
        numbers = np.full(self._scene.ngeom + 1, -1, np.int32)  # Colour 0 is the background.
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.segid >= 0:
                numbers[geom.segid + 1] = geom.objid
        parts = seen[::-1].astype(np.int32)
        return np.asarray(numbers[parts[..., 0] + (parts[..., 1] << 8) + (parts[..., 2] << 16)])

    def draw_depth(self, data: mujoco.MjData, eye: mujoco.MjvCamera | PinholeView) -> NDArray[np.float32]:
        """Rows, columns, m. In the colours of segments, for MuJoCo measures depth more finely without light."""
        nearness = np.empty(self._size, np.float32)
        with self._as_segments():
            self._draw(data, eye, self._area)
            mujoco.mjr_readPixels(None, nearness, self._area, self._drawing)
        near, far = (getattr(self._model.vis.map, name) * self._model.stat.extent for name in ("znear", "zfar"))
        depth = near * far / (near + nearness[::-1].astype(np.float64) * (far - near))
        return np.asarray(depth, np.float32)

    def close(self) -> None:
        """What is drawn is forgotten; the context stays for the thread's next scene."""
        if self._drawing is not None:
            self._context.free(self._drawing)
            self._drawing = None

    @contextmanager
    def _as_segments(self) -> Iterator[None]:
        """Draw each geom in the one colour of its number, without light."""
        flags = self._scene.flags.copy()
        for flag in ("SEGMENT", "IDCOLOR", "SHADOW", "SKYBOX"):
            self._scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = flag in ("SEGMENT", "IDCOLOR")
        yield
        self._scene.flags[:] = flags

    def _draw(
        self, data: mujoco.MjData, eye: mujoco.MjvCamera | PinholeView, area: mujoco.MjrRect, marks: Sequence[Mark] = ()
    ) -> None:
        self._context.make_current()
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._drawing)
        every = mujoco.mjtCatBit.mjCAT_ALL.value
        own = eye.eye() if isinstance(eye, PinholeView) else eye
        mujoco.mjv_updateScene(self._model, data, self._shown, None, own, every, self._scene)
        if isinstance(eye, PinholeView):
            eye.onto(self._scene.camera)
        add(self._scene, self._model, marks)
        if self.key_light is not None:
            for light in self._scene.lights[: self._scene.nlight]:
                if light.type == mujoco.mjtLightType.mjLIGHT_SPOT and not light.headlight:
                    light.pos, light.dir = self.key_light
        mujoco.mjr_render(area, self._scene, self._drawing)


@contextmanager
def _quality(model: mujoco.MjModel, height: int, width: int, shadows: float) -> Iterator[None]:
    """What a context is made with, while it is made: a model, and its hash, keep what they have."""
    screen, quality, chart = model.vis.global_, model.vis.quality, model.vis.map
    before = screen.offwidth, screen.offheight, quality.offsamples, quality.shadowsize, chart.shadowscale
    screen.offwidth, screen.offheight = width, height
    if shadows:
        quality.offsamples, quality.shadowsize = 0, _SHADOW_MAP
        chart.shadowscale = min(float(np.degrees(np.arctan2(shadows, TO_LIGHT))) / _CUTOFF, 1.0)
    try:
        yield
    finally:
        screen.offwidth, screen.offheight, quality.offsamples, quality.shadowsize, chart.shadowscale = before


def _averaged(picture: NDArray[np.uint8], fine: int) -> NDArray[np.uint8]:
    """Two pixels of three, each way: a whole one and half of the one between, weighted by their areas."""
    if fine != _FINE:
        return picture
    rows = picture.reshape(-1, 3, picture.shape[1], 3).astype(np.uint16)
    rows = np.stack([2 * rows[:, 0] + rows[:, 1], rows[:, 1] + 2 * rows[:, 2]], axis=1)
    columns = rows.reshape(2 * len(rows), -1, 3, 3)
    whole = np.stack([2 * columns[:, :, 0] + columns[:, :, 1], columns[:, :, 1] + 2 * columns[:, :, 2]], axis=2)
    return np.asarray(whole.reshape(len(whole), -1, 3) // 9, np.uint8)


class _ThreadContext:
    """A thread's own; MuJoCo draws into a buffer of its own, so that the size of this one means nothing."""

    def __init__(self) -> None:
        _check_not_forked()
        self._thread, self._context = threading.current_thread(), mujoco.GLContext(64, 64)
        self._left: list[Any] = []
        _OPENED.set()

    def make_current(self) -> None:
        """Raises ConfigError in another thread or a fork."""
        _check_not_forked()
        here = threading.current_thread()
        if here is not self._thread:
            raise ConfigError(
                f"what is rendered in the thread {self._thread.name!r} first cannot be in {here.name!r}: render it "
                "there, or make another environment or camera for this thread"
            )
        self._context.make_current()
        while self._left:
            self._left.pop().free()

    def free(self, drawing: Any) -> None:
        """Now or, from another thread, when this one renders again; in a fork never."""
        self._left.append(drawing)
        if threading.current_thread() is self._thread and not _INHERITED.is_set():
            self.make_current()


def _check_not_forked() -> None:
    if _INHERITED.is_set():
        raise ConfigError(
            "nothing can be rendered in a process that was forked from one that had rendered: start it with "
            'context="spawn"'
        )


def _context() -> _ThreadContext:
    if not hasattr(_THREAD, "context"):
        _THREAD.context = _ThreadContext()
    context: _ThreadContext = _THREAD.context
    return context
