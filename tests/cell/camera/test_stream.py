"""Pictures come at the camera's rate and late, and a frozen camera repeats its last."""

from __future__ import annotations

import mujoco
import numpy as np

from allegro_twin.cell.camera.camera import CameraStream
from allegro_twin.cell.camera.mount import CameraMount
from allegro_twin.cell.camera.settings import DepthCameraSettings
from allegro_twin.cell.perception.errors import PerceptionRefusal, check_age
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from tests.cell.camera.scenes import PLANE, WRIST, camera, scene

MOUNT = CameraMount(body="wrist", position=(0.1, 0.0, 0.0), towards=(0.1, 0.0, -0.5), up=(0.0, 1.0, 0.0))


def seen(stream: CameraStream, data: mujoco.MjData, times: list[float]) -> list[int | None]:
    numbers = []
    for time in times:
        data.time = time
        frame = stream.read(data)
        numbers.append(None if frame is None else frame.number)
    return numbers


def test_a_picture_is_there_after_its_latency_and_says_when_it_was_taken() -> None:
    model, data = scene(PLANE + WRIST)
    eye = camera(model, MOUNT, rate=30, latency=0.065)
    stream = CameraStream(eye)
    assert seen(stream, data, [0.0, 0.0334, 0.0649]) == [None, None, None]
    assert seen(stream, data, [0.0651, 0.0668, 0.0984, 0.1]) == [0, 0, 1, 1]
    frame = stream.read(data)
    assert frame is not None
    assert (frame.time, frame.ready) == (0.0334, 0.0334 + 0.065)
    eye.close()


def test_on_a_moving_wrist_the_pose_is_that_of_the_capture() -> None:
    model, data = scene(PLANE + WRIST)
    eye = camera(model, MOUNT, rate=90, latency=0.05)
    stream = CameraStream(eye)
    for step in range(12):
        data.time, data.qpos[0] = 0.01 * step, 0.1 * step
        mujoco.mj_forward(model, data)
        frame = stream.read(data)
    assert frame is not None
    turn = 10.0 * frame.time
    assert 0.05 <= data.time - frame.time < 0.075
    np.testing.assert_allclose(frame.pose.position, [0.1 * np.cos(turn), 0.1 * np.sin(turn), 0.5], atol=1e-9)
    eye.close()


def test_a_frozen_camera_repeats_its_last_picture_and_that_is_noticed_by_its_age() -> None:
    model, data = scene(PLANE + WRIST)
    eye = camera(model, MOUNT, rate=30, latency=0.0)
    stream = CameraStream(eye)
    assert seen(stream, data, [0.0, 0.034]) == [0, 1]
    eye.freeze()
    assert seen(stream, data, [0.067, 0.1, 0.5]) == [1, 1, 1]
    frame = stream.read(data)
    assert frame is not None
    assert check_age(frame.time, frame.time + 0.1, 0.3) is None
    refused = check_age(frame.time, data.time, 0.3)
    assert isinstance(refused, PerceptionRefusal)
    assert refused.reason == "stale"
    assert "0.47 s old" in str(refused)
    eye.thaw()
    assert seen(stream, data, [0.54]) == [2]
    eye.close()


def test_a_scene_that_is_reset_begins_its_pictures_anew() -> None:
    model, data = scene(PLANE + WRIST)
    eye = camera(model, MOUNT, rate=30, latency=0.01)
    stream = CameraStream(eye)
    assert seen(stream, data, [1.0, 1.02]) == [None, 0]
    assert seen(stream, data, [0.0, 0.02]) == [None, 1]
    eye.close()


def test_the_cameras_that_ship_are_read() -> None:
    for path in sorted((data_root() / "conf" / "cameras").glob("*.yaml")):
        assert load_settings(DepthCameraSettings, path).intrinsics.width == 640
