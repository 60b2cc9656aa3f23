"""The RealSense driver: depth in metres, how old it is, what is lost, and one line for what goes wrong.

The camera is a fake of librealsense's API; one test has librealsense's own software device where pyrealsense2 is
installed. No camera was ever connected to these tests.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest

from allegro_twin.drivers import realsense
from allegro_twin.drivers.realsense import RealSense, RealSenseSource, open_realsense
from allegro_twin.errors import ConfigError, LinkError, LinkTimeout
from tests.drivers.fake_realsense import FakeCamera, FakeRealSense

SMALL = RealSenseSource(width=64, height=48)


def opened(camera: FakeCamera, settings: RealSenseSource = SMALL) -> RealSense:
    return RealSense(cast(Any, FakeRealSense(camera)), camera, settings)


def counts(value: int = 500) -> np.ndarray:
    return np.full((48, 64), value, np.uint16)


@pytest.mark.parametrize("scale", [0.001, 0.0001])
def test_depth_is_in_metres_by_the_cameras_own_unit_and_zero_is_unknown(scale: float) -> None:
    camera = FakeCamera(scale=scale)
    device, shown = opened(camera), counts()
    shown[0, :3] = 0, 1, 65535
    camera.play(shown, 1)
    depth = device.newest().depth
    assert depth.dtype == np.float32
    assert np.isnan(depth[0, 0])
    np.testing.assert_allclose(depth[0, 1], scale, rtol=1e-6)
    assert depth[1, 0] == pytest.approx(500 * scale)
    assert np.isnan(depth[0, 2]) == (65535 * scale > 10.0)


def test_what_is_further_than_the_settings_say_is_unknown() -> None:
    camera = FakeCamera()
    device = opened(camera, SMALL.model_copy(update={"furthest": 0.4}))
    camera.play(counts(), 1)
    assert np.isnan(device.newest().depth).all()


def test_the_newest_picture_counts_and_those_between_are_counted_as_lost() -> None:
    camera = FakeCamera()
    device = opened(camera)
    for number in (7, 8, 12):
        camera.play(counts(number), number, stamp=33.0 * number)
    assert device.newest().number == 12
    assert device.newest().depth[0, 0] == pytest.approx(0.012)
    assert device.lost == 3


def test_a_picture_that_is_changed_after_it_came_stays_as_it_was() -> None:
    camera, shown = FakeCamera(), counts()
    device = opened(camera)
    camera.play(shown, 1)
    shown[:] = 9
    assert device.newest().depth[0, 0] == pytest.approx(0.5)


def test_other_streams_are_no_depth() -> None:
    camera = FakeCamera()
    device = opened(camera)
    camera.play(counts(), 1)
    camera.play(counts(9), 2, depth=False)
    assert device.newest().number == 1


def test_a_stamp_of_this_computers_clock_says_the_age() -> None:
    camera = FakeCamera()
    device = opened(camera)
    camera.play(counts(), 1, stamp=1e3 * (time.time() - 0.2), domain="global_time")
    assert device.newest().age == pytest.approx(0.2, abs=0.1)


def test_a_stamp_of_the_cameras_clock_counts_from_the_picture_that_came_soonest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    camera = FakeCamera()
    device = opened(camera)
    camera.play(counts(), 1, stamp=5000.0)  # Came at once: after the usual 65 ms.
    now[0] = 100.133
    camera.play(counts(), 2, stamp=5033.0)  # Was 100 ms longer on its way.
    assert device.newest().age == pytest.approx(0.065 + 0.1)
    now[0] = 100.233
    assert device.newest().age == pytest.approx(0.065 + 0.2)


def test_the_lens_is_the_cameras_own() -> None:
    assert opened(FakeCamera()).lens == (64, 48, 40.0, 41.0, 31.5, 23.5)


def late(monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    begin = time.monotonic()
    monkeypatch.setattr("time.monotonic", lambda: begin + seconds)


def test_a_camera_that_falls_silent_is_named_with_its_cable(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = FakeCamera()
    device = opened(camera)
    camera.play(counts(), 1)
    late(monkeypatch, 1.5)
    with pytest.raises(LinkTimeout, match=r"no picture from Intel RealSense D435 841 for 1\.5 s: see to its cable"):
        device.newest()


def test_a_camera_without_a_first_picture_is_not_waited_for_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realsense, "FIRST", 0.01)
    with pytest.raises(LinkTimeout, match=r"no picture from .* within 0\.01 s: plug it into a USB 3 port"):
        opened(FakeCamera()).newest()


@pytest.fixture
def plugged(monkeypatch: pytest.MonkeyPatch) -> Callable[..., FakeRealSense]:
    def plug(*cameras: FakeCamera) -> FakeRealSense:
        module = FakeRealSense(*cameras)
        monkeypatch.setitem(sys.modules, "pyrealsense2", cast(Any, module))
        return module

    return plug


def test_an_unplugged_camera_is_one_line_at_once(plugged: Callable[..., FakeRealSense]) -> None:
    camera, other = FakeCamera("1"), FakeCamera("2")
    module = plugged(camera, other)
    device = open_realsense(SMALL.model_copy(update={"serial": "1"}))
    camera.play(counts(), 1)
    module.unplug(other)
    assert device.newest().number == 1
    module.unplug(camera)
    with pytest.raises(LinkError, match="Intel RealSense D435 1 was unplugged: plug it in, and begin anew"):
        device.newest()
    device.close()


@pytest.mark.parametrize(
    ("serials", "wanted", "said"),
    [
        ([], None, "no RealSense is connected"),
        ([], "7", "no RealSense 7; connected: none"),
        (["1", "2"], None, "2 RealSense cameras are connected: choose one by `serial`: 1, 2"),
        (["1", "2"], "7", "no RealSense 7; connected: 1, 2"),
    ],
)
def test_which_camera_is_meant_is_never_guessed(
    plugged: Callable[..., FakeRealSense], serials: list[str], wanted: str | None, said: str
) -> None:
    plugged(*map(FakeCamera, serials))
    with pytest.raises(ConfigError, match=said):
        open_realsense(SMALL.model_copy(update={"serial": wanted}))


def test_a_mode_that_the_camera_lacks_is_refused_with_those_that_it_has() -> None:
    with pytest.raises(ConfigError, match="no depth of 640x480 at 30 Hz; it has 32x24 at 90 Hz, 64x48 at 30 Hz"):
        opened(FakeCamera(), RealSenseSource())


def test_depth_with_distortion_is_refused_and_the_camera_let_go() -> None:
    camera = FakeCamera(coeffs=[0.1, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(ConfigError, match="lens distortion"):
        opened(camera)
    assert camera.calls == ["open", "start", "stop", "close"]


@pytest.mark.parametrize("breaks", ["open", "start"])
def test_a_camera_that_does_not_start_is_one_line(breaks: str) -> None:
    camera = FakeCamera()
    camera.breaks = breaks
    with pytest.raises(
        LinkError, match=r"D435 841 does not start: failed to set power state \(hwmon\); plug it in anew"
    ):
        opened(camera)


@pytest.mark.parametrize("breaks", ["", "stop"])
def test_closing_twice_or_without_a_camera_is_well(breaks: str) -> None:
    camera = FakeCamera()
    device = opened(camera)
    camera.breaks = breaks
    device.close()
    device.close()
    assert camera.calls.count("stop") == 1


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(ConfigError, match=r"pip install 'allegro-twin\[realsense\]', apt-get install libusb-1.0-0"):
        open_realsense(SMALL)


def software_device() -> tuple[Any, Any, Callable[[np.ndarray, int, float], None]]:
    """librealsense, a device of its own without hardware, and how it takes a picture."""
    rs = pytest.importorskip("pyrealsense2", exc_type=ImportError, reason="needs pyrealsense2: extra realsense")
    device = rs.software_device()
    sensor, lens = device.add_sensor("Stereo Module"), rs.intrinsics()
    lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy = 64, 48, 40.0, 41.0, 31.5, 23.5
    lens.model, lens.coeffs = rs.distortion.brown_conrady, [0.0] * 5
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid, stream.fmt = rs.stream.depth, 0, 1, rs.format.z16
    stream.width, stream.height, stream.fps, stream.bpp, stream.intrinsics = 64, 48, 30, 2, lens
    profile = sensor.add_video_stream(stream)
    sensor.add_read_only_option(rs.option.depth_units, 0.001)

    def take(shown: np.ndarray, number: int, stamp: float) -> None:
        frame = rs.software_video_frame()
        frame.pixels, frame.stride, frame.bpp, frame.timestamp, frame.frame_number = shown, 128, 2, stamp, number
        frame.domain, frame.profile = rs.timestamp_domain.hardware_clock, profile.as_video_stream_profile()
        sensor.on_video_frame(frame)

    return rs, device, take


def test_librealsenses_own_software_device_is_read_like_a_camera() -> None:
    rs, software, take = software_device()
    device = RealSense(rs, software, SMALL)
    try:
        for number in (1, 2, 4):
            shown = counts(500 + number)
            shown[0, 0] = 0
            take(shown, number, 33.0 * number)
        deadline = time.monotonic() + 5.0
        while (picture := device.newest()).number < 4 and time.monotonic() < deadline:
            pass
        assert picture.number == 4
        assert picture.depth[1, 1] == pytest.approx(0.504)
        assert np.isnan(picture.depth[0, 0])
        assert device.lens == (64, 48, 40.0, 41.0, 31.5, 23.5)
        assert device.lost == 1
    finally:
        device.close()
