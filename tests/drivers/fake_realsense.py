"""As much of pyrealsense2 as the driver asks for, with cameras that a test plays."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Counts = NDArray[np.uint16]


class FakeFrame:
    """A picture of librealsense."""

    def __init__(self, counts: Counts, number: int, stamp: float, domain: str, *, depth: bool = True) -> None:
        self._values = (counts, number, stamp, domain, depth)

    def is_depth_frame(self) -> bool:
        return self._values[4]

    def get_data(self) -> Counts:
        return self._values[0]

    def get_frame_number(self) -> int:
        return self._values[1]

    def get_timestamp(self) -> float:
        """ms."""
        return self._values[2]

    def get_frame_timestamp_domain(self) -> str:
        return self._values[3]


class FakeMode:
    """A stream profile of depth."""

    def __init__(self, width: int, height: int, rate: int, kind: str, coeffs: list[float]) -> None:
        self._mode, self._kind, self._coeffs = (width, height, rate), kind, coeffs

    def stream_type(self) -> str:
        return self._kind

    def format(self) -> str:
        return "z16"

    def as_video_stream_profile(self) -> FakeMode:
        return self

    def width(self) -> int:
        return self._mode[0]

    def height(self) -> int:
        return self._mode[1]

    def fps(self) -> int:
        return self._mode[2]

    def get_intrinsics(self) -> SimpleNamespace:
        w, h, _ = self._mode
        return SimpleNamespace(
            width=w, height=h, fx=40.0, fy=41.0, ppx=w / 2 - 0.5, ppy=h / 2 - 0.5, coeffs=self._coeffs
        )


class FakeCamera:
    """A device and its depth sensor in one."""

    def __init__(self, serial: str = "841", *, scale: float = 0.001, coeffs: list[float] | None = None) -> None:
        self.serial, self.scale, self.coeffs = serial, scale, coeffs or [0.0] * 5
        self.calls: list[str] = []
        self.breaks = ""
        """The call that raises RuntimeError."""
        self._send: Callable[[FakeFrame], None] = lambda frame: None

    def supports(self, what: str) -> bool:
        return True

    def get_info(self, what: str) -> str:
        return self.serial if what == "serial_number" else "Intel RealSense D435"

    def first_depth_sensor(self) -> FakeCamera:
        return self

    def get_depth_scale(self) -> float:
        return self.scale

    def get_stream_profiles(self) -> list[FakeMode]:
        modes = [(64, 48, 30, "depth"), (32, 24, 90, "depth"), (64, 48, 30, "infrared")]
        return [FakeMode(w, h, rate, kind, self.coeffs) for w, h, rate, kind in modes]

    def open(self, profile: FakeMode) -> None:
        self._called("open")

    def start(self, send: Callable[[FakeFrame], None]) -> None:
        self._called("start")
        self._send = send

    def stop(self) -> None:
        self._called("stop")

    def close(self) -> None:
        self._called("close")

    def play(self, counts: Counts, number: int, stamp: float = 0.0, domain: str = "hardware_clock",
             *, depth: bool = True) -> None:  # fmt: skip
        """Let a picture come, with its stamp in ms."""
        self._send(FakeFrame(counts, number, stamp, domain, depth=depth))

    def _called(self, name: str) -> None:
        self.calls.append(name)
        if name == self.breaks:
            raise RuntimeError("failed to set power state\n(hwmon)")


class FakeRealSense:
    """The module, with cameras plugged in."""

    def __init__(self, *cameras: FakeCamera) -> None:
        self.cameras = list(cameras)
        self._changed: Callable[[Any], None] = lambda change: None
        self.stream = SimpleNamespace(depth="depth", infrared="infrared")
        self.format = SimpleNamespace(z16="z16")
        self.timestamp_domain = SimpleNamespace(hardware_clock="hardware_clock", global_time="global_time")
        self.camera_info = SimpleNamespace(name="name", serial_number="serial_number")

    def context(self) -> FakeRealSense:
        return self

    def query_devices(self) -> list[FakeCamera]:
        return self.cameras

    def set_devices_changed_callback(self, changed: Callable[[Any], None]) -> None:
        self._changed = changed

    def unplug(self, camera: FakeCamera) -> None:
        """Pull a camera out."""
        self._changed(SimpleNamespace(was_removed=lambda device: device is camera))
