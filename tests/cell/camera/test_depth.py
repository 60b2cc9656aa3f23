"""Depth, cloud and colour are where rays say, from wherever the camera is mounted."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from allegro_twin.cell.camera.camera import DepthCamera
from allegro_twin.cell.camera.intrinsics import D435I_DEPTH, Intrinsics
from allegro_twin.cell.camera.mount import CameraMount, CameraPose, looking
from allegro_twin.cell.camera.settings import DepthCameraSettings, DepthNoise
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.orientation import quaternion_from_matrix
from allegro_twin.types import Array
from tests.cell.camera.scenes import BALL, PLANE, SMALL, WRIST, camera, scene

ROLLED = CameraMount(position=(-0.3, -0.1, 0.45), towards=(0.1, 0.1, 0.0), up=(0.2, 0.3, 1.0))


def rays(pose: CameraPose) -> Array:
    """Of the small camera in the world, z along the view 1."""
    return D435I_DEPTH[SMALL].rays().astype(np.float64) @ pose.rotation.T


def test_depth_of_a_plane_is_that_of_rays_to_a_hundredth_of_a_millimetre() -> None:
    model, data = scene(PLANE)
    eye = camera(model, ROLLED)
    frame = eye.capture(data)
    down = rays(frame.pose)[..., 2]
    depth = np.where(down < 0.0, -frame.pose.position[2] / np.minimum(down, -1e-9), np.inf)
    near = depth < 2.0
    assert near.mean() > 0.5
    np.testing.assert_allclose(frame.depth[near], depth[near], rtol=0, atol=1e-5)
    eye.close()


def test_depth_of_a_ball_is_that_of_rays_to_the_depth_of_its_facets() -> None:
    model, data = scene(BALL)
    eye = camera(model, ROLLED)
    frame = eye.capture(data)
    ray, middle = rays(frame.pose), np.array([0.1, 0.05, 0.1]) - frame.pose.position
    a, b = np.square(ray).sum(axis=-1), ray @ middle
    under = b * b - a * (middle @ middle - 0.1**2)
    depth = (b - np.sqrt(np.maximum(under, 0.0))) / a
    normal = (depth[..., None] * ray - middle) / 0.1
    cosine = -(normal * ray).sum(axis=-1) / np.sqrt(a)
    square_on = (under > 0.0) & (cosine > 0.5)
    facet = 2.0 * 0.1 * (1.0 - np.cos(np.pi / 100))  # 100 slices and 100 stacks, MuJoCo's drawing of a sphere.
    off = frame.depth[square_on] - depth[square_on]
    assert square_on.sum() > 500
    assert off.min() > -1e-5
    assert off.max() < facet / 0.5
    eye.close()


def test_a_cloud_is_in_the_cameras_frame_and_unknown_where_depth_is() -> None:
    model, data = scene(PLANE)
    eye = camera(model, ROLLED, furthest=2.0)
    frame = eye.capture(data)
    assert frame.cloud.shape == (240, 424, 3)
    np.testing.assert_array_equal(np.isnan(frame.cloud).all(axis=-1), np.isnan(frame.depth))
    assert np.isnan(frame.depth).any()
    on = frame.pose.world(frame.cloud[frame.depth < 2.0].astype(np.float64))
    np.testing.assert_allclose(on[:, 2], 0.0, atol=2e-5)
    eye.close()


def test_a_point_of_a_cloud_falls_back_into_its_pixel() -> None:
    lens = D435I_DEPTH["640x480"]
    cloud = lens.cloud(np.full((480, 640), 0.7, np.float32))
    columns, rows = np.meshgrid(np.arange(640), np.arange(480))
    np.testing.assert_allclose(lens.pixel(cloud.astype(np.float64)), np.stack([columns, rows], axis=-1), atol=1e-3)
    assert lens == Intrinsics(640, 480, 384.2, 384.2, 319.5, 236.4)


def test_the_field_of_view_is_the_datasheets() -> None:
    left, right, up, down = D435I_DEPTH["640x480"].edges()
    assert np.degrees(np.arctan(right) - np.arctan(left)) == pytest.approx(79.6, abs=0.1)  # 384.2 pixels
    assert np.degrees(np.arctan(down) - np.arctan(up)) == pytest.approx(64.0, abs=0.1)


def test_a_camera_on_a_wrist_moves_with_it_and_a_frame_keeps_the_pose_of_its_capture() -> None:
    model, data = scene(PLANE + WRIST)
    eye = camera(
        model, CameraMount(body="wrist", position=(0.1, 0.0, 0.0), towards=(0.1, 0.0, -0.5), up=(0.0, 1.0, 0.0))
    )
    before = eye.capture(data)
    np.testing.assert_allclose(before.pose.position, [0.1, 0.0, 0.5], atol=1e-12)
    data.qpos[0] = np.pi / 2
    mujoco.mj_forward(model, data)
    after = eye.capture(data)
    np.testing.assert_allclose(after.pose.position, [0.0, 0.1, 0.5], atol=1e-12)
    np.testing.assert_allclose(before.pose.position, [0.1, 0.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(after.pose.rotation[:, 0], [0.0, 1.0, 0.0], atol=1e-12)
    eye.close()


def test_a_camera_may_stand_on_a_site_and_be_given_as_calibrations_give_it() -> None:
    model, data = scene(PLANE + WRIST)
    turn = looking((0.0, 0.0, 0.0), (0.0, 0.3, -1.0)).rotation
    w, x, y, z = (float(value) for value in quaternion_from_matrix(turn))
    pose = CameraMount(site="eye", position=(0.0, 0.0, 0.1), quaternion=(w, x, y, z)).pose(model, data)
    np.testing.assert_allclose(pose.position, [0.0, 0.0, 0.58], atol=1e-12)
    np.testing.assert_allclose(pose.rotation, turn, atol=1e-12)


@pytest.mark.parametrize(
    ("mount", "says"),
    [
        ({"body": "wirst", "position": (0, 0, 0), "towards": (0, 0, 1), "up": (1, 0, 0)}, "did you mean 'wrist'"),
        ({"site": "lens", "position": (0, 0, 0), "towards": (0, 1, 1)}, "no site named 'lens'"),
        ({"body": "wrist", "site": "eye", "position": (0, 0, 0), "towards": (0, 1, 1)}, "not on both"),
        ({"position": (0, 0, 0)}, "either a quaternion or a point"),
        ({"position": (0, 0, 1), "towards": (0, 0, 0)}, "give another `up`"),
        ({"position": (0, 0, 0.6), "towards": (0, 0, 0.6)}, "give one that differs from `position`"),
    ],
)
def test_a_mount_that_cannot_be_is_one_line(mount: dict[str, object], says: str) -> None:
    model, _ = scene(PLANE + WRIST)
    with pytest.raises(ValueError, match=says) as error:
        DepthCamera(model, DepthCameraSettings(mount=CameraMount.model_validate(mount)))
    if isinstance(error.value, ConfigError):
        assert "\n" not in str(error.value)


def test_a_colour_picture_is_taken_beside_and_shows_no_sites() -> None:
    site = '<site name="mark" type="sphere" size=".2" rgba="1 0 0 1"/>'
    red = '<geom type="sphere" size=".02" pos="0 0 .1" rgba="1 0 0 1"/>'
    light = '<light pos="0 0 3"/>'
    mount = CameraMount(position=(0.0, -0.4, 0.4), towards=(0.0, 0.0, 0.1))
    pictures = []
    for inside in (PLANE + light + site, PLANE + light + red):
        model, data = scene(inside)
        eye = camera(model, mount, colour=True)
        pictures.append(eye.capture(data).colour)
        eye.close()
    hidden, shown = pictures
    assert hidden is not None
    assert shown is not None
    assert shown.shape == (480, 640, 3)
    assert not (hidden[..., 0] > 2.0 * hidden[..., 1] + 20).any()
    rows, columns = np.nonzero(shown[..., 0] > 2.0 * shown[..., 1] + 20)
    beside = 314.3 - 612.4 * 0.015 / 0.5  # The colour camera is 15 mm to the right, 0.5 m away.
    assert columns.mean() == pytest.approx(beside, abs=1.5)
    assert rows.mean() == pytest.approx(237.8, abs=1.5)


def test_depth_noise_is_of_the_seed_and_the_number_of_the_picture() -> None:
    model, data = scene(PLANE)
    given = DepthCameraSettings(mount=ROLLED, resolution="424x240", noise=DepthNoise())
    first, again, other = DepthCamera(model, given, 5), DepthCamera(model, given, 5), DepthCamera(model, given, 6)
    one, two = first.capture(data).depth, first.capture(data).depth
    np.testing.assert_array_equal(one, again.capture(data).depth)
    np.testing.assert_array_equal(two, again.capture(data).depth)
    assert not np.array_equal(one, two, equal_nan=True)
    assert not np.array_equal(one, other.capture(data).depth, equal_nan=True)
    for eye in (first, again, other):
        eye.close()
