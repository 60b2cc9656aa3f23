"""A depth camera in a simulated scene, and its pictures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.cell.camera.intrinsics import D435I_COLOUR, D435I_COLOUR_AT, Cloud, Image, Intrinsics
from allegro_twin.cell.camera.mount import CameraPose
from allegro_twin.cell.camera.settings import DepthCameraSettings
from allegro_twin.cell.camera.stereo import Stereo
from allegro_twin.errors import ConfigError
from allegro_twin.sim.renderer import rendering_hint
from allegro_twin.viewing.gl_context import OffscreenRenderer, PinholeView


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """Depth picture of one moment, with the data to interpret it."""

    number: int
    """Pictures since the camera was switched on; one that is skipped or repeated shows here."""
    time: float
    """When it was taken, s of the scene's clock."""
    ready: float
    """When a program can have it, s: `time` and the latency."""
    depth: Image
    """(rows, columns), m along z; NaN is unknown."""
    colour: NDArray[np.uint8] | None
    """(rows, columns, RGB) of the colour camera, which stands beside; None where none was asked for."""
    lens: Intrinsics
    """Intrinsics of `depth`."""
    pose: CameraPose
    """In the world when it was taken, which on a moving wrist is not where the camera is now."""

    @cached_property
    def cloud(self) -> Cloud:
        """A point a pixel, (rows, columns, 3), m in the camera's frame; NaN is unknown."""
        return self.lens.cloud(self.depth)


class CellCamera(Protocol):
    """A depth camera of a cell, simulated, real or recorded."""

    @property
    def lens(self) -> Intrinsics:
        """Intrinsics of its depth pictures."""

    def capture(self, data: mujoco.MjData) -> CameraFrame:
        """The newest picture, on the clock of the scene and from where the camera stands in it; one that is no longer
        there repeats its last picture. Raises LinkError, RecordingError or ConfigError where there is none at all."""

    def close(self) -> None:
        """Idempotent."""


class DepthCamera:
    """Takes pictures of one model. For one thread; `close` it. Raises ConfigError where nothing can be rendered.

    Its noise is drawn from `seed` and the number of the picture: the same run has the same pictures.
    """

    def __init__(
        self, model: mujoco.MjModel, settings: DepthCameraSettings, seed: int = 0, lens: Intrinsics | None = None
    ) -> None:
        """`lens`: another than the settings' own."""
        self.settings, self._model, self._seed = settings, model, seed
        self._lens = settings.intrinsics if lens is None else lens
        self._stereo = Stereo(self._lens, settings.baseline, settings.furthest)
        settings.mount.pose(model, mujoco.MjData(model))  # Its body is there, or this raises.
        self._number, self._frozen = 0, False
        self._last: CameraFrame | None = None
        self._depth = _screen(model, self._lens)
        self._colour = _screen(model, D435I_COLOUR) if settings.colour else None

    @property
    def lens(self) -> Intrinsics:
        """Intrinsics of its depth pictures."""
        return self._lens

    @property
    def stereo(self) -> Stereo:
        """Its imagers: what it cannot see for nearness, and how far its depth scatters."""
        return self._stereo

    def capture(self, data: mujoco.MjData) -> CameraFrame:
        """A picture of the scene as it is now; of a frozen camera its last picture, stamp and all."""
        if self._frozen and self._last is not None:
            return self._last
        pose = self.settings.mount.pose(self._model, data)
        number, self._number = self._number, self._number + 1
        exact = self.exact(data, pose)
        told = self._stereo.measured(exact, self.settings.noise, np.random.default_rng((self._seed, number)))
        ready = float(data.time) + self.settings.latency
        frame = CameraFrame(number, float(data.time), ready, told, self._picture(data, pose), self._lens, pose)
        self._last = frame
        return frame

    def exact(self, data: mujoco.MjData, pose: CameraPose) -> Image:
        """Depth without any error, (rows, columns), m along z."""
        return self._depth.draw_depth(data, _view(self._lens, pose))

    def restart(self, seed: int) -> None:
        """As new, with other noise: the next picture is the first."""
        self._seed, self._number, self._last = seed, 0, None

    def freeze(self) -> None:
        """From now on it repeats its last picture, or takes one more and repeats that: a fault to inject."""
        self._frozen = True

    def thaw(self) -> None:
        """The fault is over."""
        self._frozen = False

    def close(self) -> None:
        """Idempotent."""
        for screen in (self._depth, self._colour):
            if screen is not None:
                screen.close()

    def _picture(self, data: mujoco.MjData, pose: CameraPose) -> NDArray[np.uint8] | None:
        if self._colour is None:
            return None
        beside = pose._replace(position=pose.world(np.array(D435I_COLOUR_AT)))
        return self._colour.draw(data, _view(D435I_COLOUR, beside))


class CameraStream:
    """A camera that runs: pictures at its rate, each there after its latency.

    `read` is called as often as anything else happens, with the scene as it is then.
    """

    def __init__(self, camera: DepthCamera) -> None:
        self._camera, self._count = camera, -1
        self._begin: float | None = None
        self._waiting: list[CameraFrame] = []
        self._newest: CameraFrame | None = None

    def read(self, data: mujoco.MjData) -> CameraFrame | None:
        """The newest picture that is there by now, or None before the first; takes one when one is due."""
        now = float(data.time)
        if self._begin is None or now < self._begin:  # A scene that was reset begins anew.
            self._begin, self._count, self._waiting, self._newest = now, -1, [], None
        due = int(np.floor((now - self._begin) * self._camera.settings.rate + 1e-6))
        if due > self._count:
            self._count = due
            self._waiting.append(self._camera.capture(data))
        while self._waiting and self._waiting[0].ready <= now + 1e-9:
            self._newest = self._waiting.pop(0)
        return self._newest


def _view(lens: Intrinsics, pose: CameraPose) -> PinholeView:
    return PinholeView(pose.position, pose.rotation, *lens.edges())


def _screen(model: mujoco.MjModel, lens: Intrinsics) -> OffscreenRenderer:
    try:
        return OffscreenRenderer(model, lens.height, lens.width, sites=False)
    except (ImportError, AttributeError, RuntimeError, OSError, mujoco.FatalError) as error:
        raise ConfigError(f"cannot render: {rendering_hint()} ({str(error).strip().splitlines()[0]})") from error
