"""Depth pictures of an Intel RealSense camera, by pyrealsense2.

The depth sensor itself is opened, without librealsense's pipeline: so the same code runs with a camera, with a
recording of one and with its software device. Pictures come in a thread of librealsense; the newest is kept.
"""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from types import ModuleType
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from allegro_twin.errors import ConfigError, LinkError, LinkTimeout
from allegro_twin.files.schema import Positive, Settings

FIRST = 5.0
"""s that a camera may take until its first picture: it starts its projector and settles its exposure."""
_MS = 1e-3
_LATENCY = 0.065  # s, of a picture whose clock is the camera's own (librealsense #1242: 60 to 70 ms for depth).


class RealSenseSource(Settings):
    """Pictures come from a RealSense camera."""

    kind: Literal["realsense"] = "realsense"
    serial: str | None = None
    """Serial number of the camera. None: the only one."""
    width: Annotated[int, Field(ge=1)] = 640
    height: Annotated[int, Field(ge=1)] = 480
    """Pixels of the depth picture."""
    rate: Annotated[int, Field(ge=1)] = 30
    """Pictures a second."""
    furthest: Positive = 10.0
    """Beyond it nothing is known, m."""
    silence: Positive = 1.0
    """s without a picture after which the camera counts as lost."""


class DepthPicture(NamedTuple):
    """One depth picture of a device."""

    number: int
    """As the device counts: numbers that are missing are pictures that were lost."""
    age: float
    """s since it was taken."""
    depth: NDArray[np.float32]
    """(rows, columns), m along z; NaN is unknown."""


class _Arrived(NamedTuple):
    """A picture as it came."""

    number: int
    stamp: float
    """s, of `clock`."""
    host: bool
    """Whether the stamp is of this computer's clock; otherwise of the camera's own."""
    at: float
    """s, monotonic, when it came."""
    counts: NDArray[np.uint16]


class RealSense:
    """An open camera. For one thread; `close` it."""

    def __init__(self, rs: ModuleType, device: Any, settings: RealSenseSource) -> None:
        """`rs` is pyrealsense2 and `device` one of its devices. Raises ConfigError for a mode that it does not have,
        LinkError where it does not start."""
        self._settings, self._rs, self._device = settings, rs, device
        self.name = _info(rs, device)
        self._ready = threading.Condition()
        self._arrived: _Arrived | None = None
        self._offset, self._first, self._lost, self._gone = np.inf, time.monotonic(), 0, False
        self._open = False
        try:
            self._sensor = device.first_depth_sensor()
            profile = _profile(rs, self._sensor, settings, self.name)
            self._scale = float(self._sensor.get_depth_scale())
            lens = profile.get_intrinsics()
            self._sensor.open(profile)
            self._open = True
            self._sensor.start(self._on_frame)
        except RuntimeError as error:
            self.close()
            raise LinkError(
                f"{self.name} does not start: {_line(error)}; plug it in anew, into a USB 3 port"
            ) from error
        if any(abs(value) > 1e-6 for value in lens.coeffs):
            self.close()
            raise ConfigError(f"{self.name}: its depth picture has lens distortion, which is not supported")
        self.lens = (lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy)
        """Width and height, and fx, fy, cx, cy, pixels."""

    @property
    def lost(self) -> int:
        """Pictures between others that did not come."""
        return self._lost

    def newest(self) -> DepthPicture:
        """The newest picture, at once but for the first. Raises LinkError when the camera is unplugged, LinkTimeout
        when no picture comes any more."""
        with self._ready:
            self._ready.wait_for(lambda: self._arrived is not None or self._gone, timeout=FIRST)
            arrived, now = self._arrived, time.monotonic()
        if self._gone:
            raise LinkError(f"{self.name} was unplugged: plug it in, and begin anew")
        if arrived is None:
            raise LinkTimeout(f"no picture from {self.name} within {FIRST:g} s: plug it into a USB 3 port")
        if now - arrived.at > self._settings.silence:
            raise LinkTimeout(f"no picture from {self.name} for {now - arrived.at:.1f} s: see to its cable")
        depth = arrived.counts.astype(np.float32) * np.float32(self._scale)
        depth[(arrived.counts == 0) | (depth > self._settings.furthest)] = np.nan
        return DepthPicture(arrived.number, self._age(arrived, now), depth)

    def on_removed(self) -> None:
        """The device is no longer there."""
        with self._ready:
            self._gone = True
            self._ready.notify_all()

    def close(self) -> None:
        """Idempotent."""
        if self._open:
            self._open = False
            with suppress(RuntimeError):  # Of a camera that is unplugged nothing can be stopped.
                self._sensor.stop()
                self._sensor.close()

    def _age(self, arrived: _Arrived, now: float) -> float:
        """By the clock of this computer where librealsense has translated the stamp; otherwise as old as the picture
        that came soonest after its stamp, and what it has waited since."""
        if arrived.host:
            return max(time.time() - arrived.stamp, 0.0)
        return max(now - arrived.stamp - self._offset, 0.0) + _LATENCY

    def _on_frame(self, frame: Any) -> None:
        """In a thread of librealsense, whose memory the frame is."""
        if not frame.is_depth_frame():
            return
        own = frame.get_frame_timestamp_domain() == self._rs.timestamp_domain.hardware_clock
        stamp, number = float(frame.get_timestamp()) * _MS, int(frame.get_frame_number())
        arrived = _Arrived(number, stamp, not own, time.monotonic(), np.array(frame.get_data(), np.uint16))
        with self._ready:
            if self._arrived is not None:
                self._lost += max(number - self._arrived.number - 1, 0)
            self._arrived, self._offset = arrived, min(self._offset, arrived.at - stamp)
            self._ready.notify_all()


def open_realsense(settings: RealSenseSource) -> RealSense:
    """Open a camera. Raises ConfigError without the extra and for a camera that is not there, LinkError where it does
    not start."""
    rs = _pyrealsense2()
    context = rs.context()
    devices = {str(each.get_info(rs.camera_info.serial_number)): each for each in context.query_devices()}
    there = ", ".join(devices) or "none"
    if settings.serial is not None and settings.serial not in devices:
        raise ConfigError(f"no RealSense {settings.serial}; connected: {there}")
    if settings.serial is None and len(devices) != 1:
        raise ConfigError(
            "no RealSense is connected: see to its cable" if not devices
            else f"{len(devices)} RealSense cameras are connected: choose one by `serial`: {there}"
        )  # fmt: skip
    device = devices[settings.serial] if settings.serial is not None else next(iter(devices.values()))
    camera = RealSense(rs, device, settings)
    context.set_devices_changed_callback(lambda change: camera.on_removed() if change.was_removed(device) else None)
    camera._context = context  # type: ignore[attr-defined]  # It calls back for as long as it lives.
    return camera


def _pyrealsense2() -> ModuleType:
    try:
        import pyrealsense2
    except ImportError as error:
        raise ConfigError(
            f"a RealSense needs pyrealsense2 and libusb: pip install 'allegro-twin[realsense]', "
            f"apt-get install libusb-1.0-0 ({error})"
        ) from error
    module: ModuleType = pyrealsense2
    return module


def _profile(rs: ModuleType, sensor: Any, settings: RealSenseSource, name: str) -> Any:
    """The depth mode of the settings."""
    modes = []
    for each in sensor.get_stream_profiles():
        if each.stream_type() != rs.stream.depth or each.format() != rs.format.z16:
            continue
        video = each.as_video_stream_profile()
        mode = (video.width(), video.height(), each.fps())
        if mode == (settings.width, settings.height, settings.rate):
            return video
        modes.append(mode)
    known = ", ".join(sorted({f"{w}x{h} at {fps} Hz" for w, h, fps in modes})) or "none"
    wanted = f"{settings.width}x{settings.height} at {settings.rate} Hz"
    raise ConfigError(f"{name} has no depth of {wanted}; it has {known}")


def _info(rs: ModuleType, device: Any) -> str:
    parts = [device.get_info(each) for each in (rs.camera_info.name, rs.camera_info.serial_number)
             if device.supports(each)]  # fmt: skip
    return " ".join(map(str, parts)) or "the RealSense camera"


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
