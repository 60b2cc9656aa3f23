"""Depth cameras that are not simulated, a RealSense and a ROS bag, behind the contract of the simulated one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco

from allegro_twin.cell.camera.camera import CameraFrame, CellCamera, DepthCamera
from allegro_twin.cell.camera.intrinsics import Intrinsics
from allegro_twin.cell.camera.mount import CameraMount, CameraPose
from allegro_twin.cell.camera.settings import DepthCameraSettings, RecordingSource
from allegro_twin.drivers.realsense import RealSense, RealSenseSource, open_realsense
from allegro_twin.errors import ConfigError, LinkError
from allegro_twin.recording.exchange.depth_bag import BagDepth, read_depth

_SOON = 1e-9  # s.


def open_camera(model: mujoco.MjModel, settings: DepthCameraSettings, seed: int = 0) -> CellCamera:
    """The camera that the settings name as `source`. Raises ConfigError, LinkError, RecordingError."""
    match settings.source:
        case RealSenseSource() as source:
            return RealSenseCamera(model, settings.mount, open_realsense(source))
        case RecordingSource() as source:
            return RecordedCamera(model, settings.mount, source)
        case _:
            return DepthCamera(model, settings, seed)


class RealSenseCamera:
    """A RealSense in the scene that mirrors its surroundings. For one thread; `close` it.

    A picture is as old as the camera says, before the scene's time at which it is asked for: the scene runs in real
    time. Its pose is that of the mount when it is asked for: look while the arm rests.
    """

    def __init__(self, model: mujoco.MjModel, mount: CameraMount, device: RealSense) -> None:
        """`device` is closed with it. Raises ConfigError for a mount on what is not in the scene."""
        self._model, self._mount, self._device = model, mount, device
        self._last: CameraFrame | None = None
        mount.pose(model, mujoco.MjData(model))
        self._lens = Intrinsics(*device.lens)

    @property
    def lens(self) -> Intrinsics:
        """Intrinsics of its depth pictures."""
        return self._lens

    def capture(self, data: mujoco.MjData) -> CameraFrame:
        """The newest picture; the last one again where no other has come, or none comes any more. Raises LinkError
        before the first."""
        try:
            picture = self._device.newest()
        except LinkError:
            if self._last is None:
                raise
            return self._last  # Its age tells: `check_age` of perception ends the run.
        if self._last is None or picture.number != self._last.number:
            now = float(data.time)
            pose = self._mount.pose(self._model, data)
            self._last = CameraFrame(picture.number, now - picture.age, now, picture.depth, None, self._lens, pose)
        return self._last

    def close(self) -> None:
        """Idempotent."""
        self._device.close()


class RecordedCamera:
    """The depth pictures of a ROS bag, at their own pace from the first look on; after the last that one again. For
    one thread; `close` it. Raises ConfigError, RecordingError."""

    def __init__(self, model: mujoco.MjModel, mount: CameraMount, source: RecordingSource) -> None:
        self._model, self._mount, self._source = model, mount, source
        mount.pose(model, mujoco.MjData(model))
        self._begin: float | None = None
        self._last: CameraFrame | None = None
        self._number = 0
        self._pictures = self._read()
        self._next: BagDepth | None = next(self._pictures)
        self._lens = Intrinsics(*self._next.lens)

    @property
    def lens(self) -> Intrinsics:
        """Intrinsics of its depth pictures."""
        return self._lens

    def capture(self, data: mujoco.MjData) -> CameraFrame:
        """The newest picture by the scene's time since the first look. A scene that was reset begins anew."""
        now = float(data.time)
        if self._begin is not None and now < self._begin:
            self._pictures, self._begin, self._last, self._number = self._read(), None, None, 0
            self._next = next(self._pictures)
        if self._begin is None:
            self._begin = now
        while self._next is not None and self._next.time <= now - self._begin + _SOON:
            self._last, self._next = self._frame(self._next, data), next(self._pictures, None)
            self._number += 1
        assert self._last is not None
        return self._last

    def close(self) -> None:
        """Idempotent."""
        self._pictures = iter(())  # Closes the bag.
        self._next = None

    def _read(self) -> Iterator[BagDepth]:
        return read_depth(Path(self._source.file), self._source.topic, self._source.world)

    def _frame(self, picture: BagDepth, data: mujoco.MjData) -> CameraFrame:
        assert self._begin is not None
        if Intrinsics(*picture.lens) != self._lens and picture.depth.shape != (self._lens.height, self._lens.width):
            raise ConfigError(f"{self._source.file}: its pictures change their size; choose one camera by `topic`")
        if self._source.pose == "config":
            pose = self._mount.pose(self._model, data)
        elif picture.pose is None:
            raise ConfigError(
                f"{self._source.file}: no transforms lead from {self._source.world!r} to {picture.frame!r}; "
                "set `pose: config`, or name another `world`"
            )
        else:
            pose = CameraPose(*picture.pose)
        taken = self._begin + picture.time
        return CameraFrame(self._number, taken, taken, picture.depth, None, self._lens, pose)
