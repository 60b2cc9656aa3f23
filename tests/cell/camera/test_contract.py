"""What a cell asks of its camera, kept by every kind of camera: simulated, RealSense and recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np
import pytest

from allegro_twin.cell.camera.camera import CellCamera
from allegro_twin.cell.camera.mount import CameraMount
from allegro_twin.cell.camera.settings import DepthCameraSettings, RecordingSource
from allegro_twin.cell.camera.sources import RealSenseCamera, RecordedCamera, open_camera
from allegro_twin.drivers.realsense import RealSense, RealSenseSource
from allegro_twin.errors import ConfigError, LinkError
from allegro_twin.files.schema import parse_settings
from tests.cell.camera.scenes import BALL, PLANE, WRIST, camera, scene
from tests.drivers.fake_realsense import FakeCamera, FakeRealSense
from tests.recording.depth_bags import FRAME, SECOND, bag

MOUNT = CameraMount(body="wrist", position=(0.0, 0.0, -0.02), towards=(0.1, 0.0, -0.5), up=(1.0, 0.0, 0.0))
T0 = 1_700_000_000 * SECOND


class Rig:
    """A camera on a wrist, and how its next picture comes about."""

    def __init__(
        self, camera: CellCamera, data: mujoco.MjData, model: mujoco.MjModel, play: Callable[[], None] = lambda: None
    ) -> None:
        self.camera, self.data, self.model, self._play = camera, data, model, play

    def advance(self) -> None:
        """The world goes on by a tenth of a second, and there is a new picture."""
        self.data.time += 0.1
        self.data.qpos[0] += 0.3
        mujoco.mj_forward(self.model, self.data)
        self._play()


class CameraContract:
    """The rules."""

    @pytest.fixture
    def rig(self, tmp_path: Path) -> Iterator[Rig]:
        raise NotImplementedError

    def test_depth_is_a_float_a_pixel_of_the_lens_and_unknown_is_nan(self, rig: Rig) -> None:
        frame = rig.camera.capture(rig.data)
        assert frame.depth.shape == (frame.lens.height, frame.lens.width)
        assert frame.depth.dtype == np.float32
        assert np.isnan(frame.depth).any()
        known = frame.depth[~np.isnan(frame.depth)]
        assert known.size > 0.2 * frame.depth.size
        assert ((known > 0.0) & np.isfinite(known)).all()

    def test_the_lens_is_known_before_any_picture_and_is_that_of_every_picture(self, rig: Rig) -> None:
        lens = rig.camera.lens
        assert rig.camera.capture(rig.data).lens == lens

    def test_the_cloud_is_the_depth_through_the_lens(self, rig: Rig) -> None:
        frame = rig.camera.capture(rig.data)
        np.testing.assert_array_equal(frame.cloud[..., 2], frame.depth)
        row, column = np.argwhere(~np.isnan(frame.depth))[-1]
        np.testing.assert_allclose(frame.lens.pixel(frame.cloud[row, column]), [column, row], atol=1e-3)

    def test_a_picture_is_not_of_the_future_nor_there_before_it_was_taken(self, rig: Rig) -> None:
        frame = rig.camera.capture(rig.data)
        assert frame.time <= rig.data.time + 1e-9
        assert frame.ready >= frame.time

    def test_the_next_picture_has_a_higher_number_and_a_later_time(self, rig: Rig) -> None:
        before = rig.camera.capture(rig.data)
        rig.advance()
        after = rig.camera.capture(rig.data)
        assert after.number > before.number
        assert after.time > before.time

    def test_a_picture_is_from_where_the_mount_was(self, rig: Rig) -> None:
        for _ in range(2):
            frame, pose = rig.camera.capture(rig.data), MOUNT.pose(rig.model, rig.data)
            np.testing.assert_allclose(frame.pose.position, pose.position)
            np.testing.assert_allclose(frame.pose.rotation, pose.rotation)
            rig.advance()

    def test_a_picture_stays_as_it_was(self, rig: Rig) -> None:
        before = rig.camera.capture(rig.data)
        copy = before.depth.copy()
        rig.advance()
        rig.camera.capture(rig.data)
        np.testing.assert_array_equal(before.depth, copy)

    def test_closing_twice_is_well(self, rig: Rig) -> None:
        rig.camera.close()
        rig.camera.close()


class TestSimulated(CameraContract):
    @pytest.fixture
    def rig(self, tmp_path: Path) -> Iterator[Rig]:
        model, data = scene(PLANE + BALL + WRIST)
        made = camera(model, MOUNT, DepthCameraSettings(mount=MOUNT).noise)
        yield Rig(made, data, model)
        made.close()


def shown(number: int) -> np.ndarray:
    """Counts of mm, (48, 64)."""
    depth = np.full((48, 64), 500 + number)
    depth[:5] = 0
    return depth


class TestRealSense(CameraContract):
    @pytest.fixture
    def rig(self, tmp_path: Path) -> Iterator[Rig]:
        model, data = scene(PLANE + WRIST)
        device = FakeCamera()
        driver = RealSense(cast(Any, FakeRealSense(device)), device, RealSenseSource(width=64, height=48))
        made = RealSenseCamera(model, MOUNT, driver)
        number = [1]

        def play() -> None:
            device.play(shown(number[0]).astype(np.uint16), number[0], stamp=100.0 * number[0])
            number[0] += 1

        data.time = 5.0
        play()
        yield Rig(made, data, model, play)
        made.close()

    def test_the_age_of_a_picture_is_before_the_scenes_time(self, rig: Rig) -> None:
        frame = rig.camera.capture(rig.data)
        assert frame.ready == 5.0
        assert 4.8 < frame.time <= 5.0 - 0.065 + 1e-9

    def test_without_a_new_picture_it_is_the_last_one_with_its_number_and_time(self, rig: Rig) -> None:
        frame = rig.camera.capture(rig.data)
        rig.data.time += 0.01
        assert rig.camera.capture(rig.data) is frame

    def test_a_camera_that_is_pulled_out_repeats_its_last_picture_whose_age_tells(self, rig: Rig) -> None:
        frame = rig.camera.capture(rig.data)
        assert isinstance(rig.camera, RealSenseCamera)
        rig.camera._device.on_removed()
        rig.data.time += 1.0
        assert rig.camera.capture(rig.data) is frame

    def test_a_camera_that_is_pulled_out_before_its_first_picture_is_an_error(self, rig: Rig) -> None:
        assert isinstance(rig.camera, RealSenseCamera)
        rig.camera._device.on_removed()
        with pytest.raises(LinkError, match="was unplugged"):
            rig.camera.capture(rig.data)


def recorded(path: Path, model: mujoco.MjModel, **more: Any) -> RecordedCamera:
    with bag(path) as made:
        made.info(T0)
        for k in range(3):
            made.transform(T0 + k * SECOND // 10, "world", FRAME, np.array([k, 0.0, 1.0, 0, 1, 0, 0]), "/tf")
            made.image(T0 + k * SECOND // 10, shown(k))
    return RecordedCamera(model, MOUNT, RecordingSource(file=str(path), **more))


class TestRecorded(CameraContract):
    @pytest.fixture
    def rig(self, tmp_path: Path) -> Iterator[Rig]:
        model, data = scene(PLANE + WRIST)
        made = recorded(tmp_path / "a.mcap", model)
        yield Rig(made, data, model)
        made.close()

    def test_pictures_come_at_their_own_pace_from_the_first_look_on(self, rig: Rig) -> None:
        rig.data.time, seen = 7.0, []
        for t in (7.0, 7.05, 7.1, 7.19, 7.21, 9.0):
            rig.data.time = t
            frame = rig.camera.capture(rig.data)
            seen.append((frame.number, round(frame.time, 6), round(float(frame.depth[9, 9]), 3)))
        assert seen == [
            (0, 7.0, 0.5),
            (0, 7.0, 0.5),
            (1, 7.1, 0.501),
            (1, 7.1, 0.501),
            (2, 7.2, 0.502),
            (2, 7.2, 0.502),
        ]

    def test_a_scene_that_is_reset_begins_anew(self, rig: Rig) -> None:
        rig.data.time = 7.0
        rig.camera.capture(rig.data)
        rig.data.time = 7.2
        assert rig.camera.capture(rig.data).number == 2
        rig.data.time = 0.0
        assert rig.camera.capture(rig.data).number == 0


def test_a_recording_may_say_itself_where_its_camera_was(tmp_path: Path) -> None:
    model, data = scene(PLANE + WRIST)
    made = recorded(tmp_path / "a.mcap", model, pose="bag")
    made.capture(data)
    data.time = 0.2
    np.testing.assert_allclose(made.capture(data).pose.position, [2.0, 0.0, 1.0])


def test_a_recording_that_does_not_say_where_its_camera_was_is_refused(tmp_path: Path) -> None:
    model, data = scene(PLANE + WRIST)
    made = recorded(tmp_path / "a.mcap", model, pose="bag", world="map")
    with pytest.raises(ConfigError, match="no transforms lead from 'map' to 'camera_depth_optical_frame'; set `pose"):
        made.capture(data)


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ({"kind": "webcam"}, "kind.*'simulated', 'realsense', 'recording'"),
        ({"kind": "recording"}, "file: missing"),
        ({"kind": "realsense", "seral": "7"}, "did you mean 'serial'"),
    ],
)
def test_a_wrong_source_is_one_line(source: dict[str, str], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        parse_settings(DepthCameraSettings, {"mount": MOUNT.model_dump(exclude_defaults=True), "source": source}, "x")


def test_a_recording_that_is_not_there_is_refused_when_the_camera_opens(tmp_path: Path) -> None:
    model, _ = scene(PLANE + WRIST)
    settings = DepthCameraSettings(mount=MOUNT, source=RecordingSource(file=str(tmp_path / "none.mcap")))
    with pytest.raises(OSError, match=r"no bag at .*none\.mcap"):
        open_camera(model, settings)


def test_a_mount_on_what_is_not_there_is_refused_by_every_camera(tmp_path: Path) -> None:
    model, _ = scene(PLANE)
    device = FakeCamera()
    driver = RealSense(cast(Any, FakeRealSense(device)), device, RealSenseSource(width=64, height=48))
    with pytest.raises(ConfigError, match="wrist"):
        RealSenseCamera(model, MOUNT, driver)
    with pytest.raises(ConfigError, match="wrist"):
        recorded(tmp_path / "a.mcap", model)
