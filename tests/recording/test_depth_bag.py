"""Depth from ROS bags: pictures and clouds in metres, the lens, the camera's pose, and one line for what is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.recording.exchange.depth_bag import BagDepth, read_depth
from allegro_twin.recording.messages import build
from allegro_twin.recording.messages import message_types as v
from tests.recording.depth_bags import DEPTH, FRAME, INFO, LENS, POINTS, SECOND, BagWriter, bag

T0 = 1_700_000_000 * SECOND
SHAPE = (48, 64)
TURN = np.array([0.1, 0.2, 0.3, 0.0, 1.0, 0.0, 0.0])  # Half a turn about x.


def plane(value: float = 500.0) -> np.ndarray:
    depth = np.full(SHAPE, value)
    depth[0, :2] = 0.0
    return depth


def points_of(depth: np.ndarray) -> np.ndarray:
    """(rows, columns, 3) of depth in m, NaN where it is 0."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    z = np.where(depth > 0.0, depth, np.nan)
    _, _, fx, fy, cx, cy = LENS
    return np.stack([(column - cx) / fx * z, (row - cy) / fy * z, z], axis=-1)


def first(path: Path, **more: str) -> BagDepth:
    return next(read_depth(path, **more))


@pytest.mark.parametrize("name", ["a.mcap", "a"])
@pytest.mark.parametrize(("encoding", "unit"), [("16UC1", 1e-3), ("32FC1", 1.0)])
def test_pictures_are_metres_and_zero_or_nan_is_unknown(tmp_path: Path, name: str, encoding: str, unit: float) -> None:
    shown = plane(500.0 if unit < 1.0 else 0.5)
    if encoding == "32FC1":
        shown[0, 1], shown[0, 2] = np.nan, np.inf
    with bag(tmp_path / name) as made:
        made.info(T0)
        made.image(T0, shown, encoding)
        made.image(T0 + SECOND // 4, shown, encoding, pad=6)
    one, other = read_depth(tmp_path / name)
    assert one.depth.dtype == np.float32
    assert np.isnan(one.depth[0, :2]).all()
    assert np.isnan(one.depth[0, 2]) == (encoding == "32FC1")
    np.testing.assert_allclose(one.depth[1:], 0.5, rtol=1e-6)
    np.testing.assert_array_equal(other.depth, one.depth)
    assert (one.time, other.time) == (0.0, 0.25)
    assert one.lens == LENS
    assert one.frame == FRAME
    assert one.pose is None


def test_a_cloud_with_rows_is_a_picture_and_tells_its_own_lens(tmp_path: Path) -> None:
    shown = plane(0.5)
    shown[20:30, 20:30] = 0.4
    with bag(tmp_path / "a.mcap") as made:
        made.cloud(T0, points_of(shown))
    found = first(tmp_path / "a.mcap")
    np.testing.assert_array_equal(found.depth, np.where(shown > 0.0, shown, np.nan).astype(np.float32))
    assert found.lens[:2] == (64, 48)
    np.testing.assert_allclose(found.lens[2:], LENS[2:], atol=1e-3)


def test_a_cloud_without_rows_falls_into_the_pixels_of_its_camera_nearest_first(tmp_path: Path) -> None:
    near, far = points_of(plane(0.4)), points_of(plane(0.5))
    mixed = np.concatenate([far.reshape(1, -1, 3), near[:24].reshape(1, -1, 3)], axis=1)
    with bag(tmp_path / "a.mcap") as made:
        made.info(T0)
        made.cloud(T0, mixed)
    found = first(tmp_path / "a.mcap")
    assert np.isnan(found.depth[0, :2]).all()
    np.testing.assert_allclose(found.depth[1:24], 0.4, rtol=1e-6)
    np.testing.assert_allclose(found.depth[24:], 0.5, rtol=1e-6)


def test_pictures_of_depth_count_before_clouds_and_a_topic_before_both(tmp_path: Path) -> None:
    with bag(tmp_path / "a.mcap") as made:
        made.info(T0)
        made.image(T0, plane())
        made.cloud(T0, points_of(plane(0.3)))
    assert first(tmp_path / "a.mcap").depth[5, 5] == pytest.approx(0.5)
    assert first(tmp_path / "a.mcap", topic=POINTS).depth[5, 5] == pytest.approx(0.3)


@pytest.mark.parametrize("kind", ["picture", "cloud with rows", "cloud without rows"])
def test_depths_that_look_like_millimetres_are_refused_with_the_way_to_metres(tmp_path: Path, kind: str) -> None:
    with bag(tmp_path / "a.mcap") as made:
        made.info(T0)
        if kind == "picture":
            made.image(T0, plane(460.0), "32FC1")
        else:
            points = points_of(plane(460.0))
            made.cloud(T0, points if kind == "cloud with rows" else points.reshape(1, -1, 3))
    with pytest.raises(ConfigError, match=r"half of the depths are beyond 460 m, so they look like mm; .* by 1000"):
        first(tmp_path / "a.mcap")


def test_the_cameras_pose_goes_through_every_frame_between(tmp_path: Path) -> None:
    lifted = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    with bag(tmp_path / "a.mcap") as made:
        made.info(T0)
        made.transform(T0, "world", "base", lifted)
        made.transform(T0, "camera_link", FRAME, TURN)
        made.transform(T0, "base", "camera_link", np.array([1.0, 0, 0, 1, 0, 0, 0]), "/tf")
        made.transform(T0 + SECOND, "base", "camera_link", np.array([2.0, 0, 0, 1, 0, 0, 0]), "/tf")
        made.image(T0, plane())
        made.image(T0 + SECOND, plane())
    one, other = read_depth(tmp_path / "a.mcap")
    assert one.pose is not None
    assert other.pose is not None
    np.testing.assert_allclose(one.pose.position, [1.1, 0.2, 1.3])
    np.testing.assert_allclose(other.pose.position, [2.1, 0.2, 1.3])
    np.testing.assert_allclose(one.pose.rotation, np.diag([1.0, -1.0, -1.0]), atol=1e-12)
    upside = first(tmp_path / "a.mcap", world="base").pose
    assert upside is not None
    np.testing.assert_allclose(upside.position, [1.1, 0.2, 0.3])
    assert first(tmp_path / "a.mcap", world="map").pose is None


def test_a_cloud_that_is_not_in_its_cameras_optical_frame_is_refused(tmp_path: Path) -> None:
    optical = points_of(plane(0.5))
    body = optical[..., [2, 0, 1]] * [1.0, -1.0, -1.0]  # x ahead, y left, z up.
    for rows in (slice(None), None):
        for shape, said in ((body, "x is ahead"), (optical - np.array([0.0, 0.0, 2.0]), "100 % of a cloud's points")):
            path = tmp_path / f"{len(list(tmp_path.iterdir()))}.mcap"
            with bag(path) as made:
                made.info(T0)
                made.cloud(T0, shape if rows else shape.reshape(1, -1, 3))
            with pytest.raises(ConfigError, match=said):
                first(path)
    with bag(tmp_path / "other.mcap") as made:
        made.info(T0, (64, 48, 46.0, 46.0, 31.0, 23.0))
        made.cloud(T0, optical)
    with pytest.raises(ConfigError, match="pixels from where its CameraInfo has them"):
        first(tmp_path / "other.mcap")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("arm", FRAME, TURN, "/tf_static"), f"the frame {FRAME} is in camera_link and in arm"),
        (("camera_link", FRAME, TURN + 0.1 * np.eye(7)[0], "/tf_static"), "has two places in camera_link"),
        (("camera_link", FRAME, TURN + 0.1 * np.eye(7)[0], "/tf"), "is static and moves"),
        (("camera_link", FRAME, np.zeros(7), "/tf_static"), "are no pose"),
        (("camera_link", FRAME, TURN, "/tf_static"), None),  # Latched twice.
    ],
)
def test_transforms_that_contradict_each_other_are_refused(
    tmp_path: Path, more: tuple[str, str, np.ndarray, str], said: str | None
) -> None:
    with bag(tmp_path / "a.mcap") as made:
        made.info(T0)
        made.transform(T0, "world", "camera_link", np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]))
        made.transform(T0, "camera_link", FRAME, TURN)
        made.transform(T0, *more)
        for parent in ("table", "palm"):  # An object that is picked changes its parent.
            made.transform(T0, parent, "object", TURN, "/tf")
        made.image(T0, plane())
    if said is None:
        assert first(tmp_path / "a.mcap").pose is not None
        return
    with pytest.raises(ConfigError, match=said):
        first(tmp_path / "a.mcap")


def test_a_moving_frame_that_was_told_long_before_the_picture_is_refused(tmp_path: Path) -> None:
    with bag(tmp_path / "a.mcap") as made:
        made.info(T0)
        made.transform(T0 - 3 * SECOND, "world", FRAME, TURN, "/tf")
        made.image(T0, plane())
    with pytest.raises(ConfigError, match=r"was told 3\.0 s from the picture"):
        first(tmp_path / "a.mcap")


def stamped(made: BagWriter, stamp: int, at: int, depth: float) -> None:
    """A picture whose stamp, ns, is not when it was recorded."""
    made.info(at)
    data = np.ascontiguousarray(plane(depth).astype("<u2")).view(np.uint8).ravel()
    message = made.types.make(
        "sensor_msgs/msg/Image", header=made.types.header(stamp, FRAME), height=48, width=64, encoding="16UC1",
        is_bigendian=0, step=128, data=data)  # fmt: skip
    made.write(DEPTH, at, message)


def placed(made: BagWriter, stamp: int, at: int, x: float) -> None:
    """The camera at x, m, told in /tf with a stamp, ns, that is not when it was recorded."""
    made.write("/tf", at, made.types.make(v.TF, transforms=[
        build.transform(made.types, stamp, "world", FRAME, np.array([x, 0, 0, 1, 0, 0, 0]))]))  # fmt: skip


@pytest.mark.parametrize("stamps", [(0.0, 0.1, 0.2), (0.0, 0.0, 0.0)])
def test_a_bag_from_a_simulation_or_without_stamps_has_one_clock(tmp_path: Path, stamps: tuple[float, ...]) -> None:
    with bag(tmp_path / "a.mcap") as made:
        for k, stamp in enumerate(stamps):
            stamped(made, round(stamp * SECOND), T0 + k * SECOND // 10, 400.0 + 100.0 * k)
            placed(made, round(stamp * SECOND), T0 + k * SECOND // 10, float(k))
    found = list(read_depth(tmp_path / "a.mcap"))
    np.testing.assert_allclose([each.time for each in found], [0.0, 0.1, 0.2])
    np.testing.assert_allclose([each.depth[5, 5] for each in found], [0.4, 0.5, 0.6])
    assert [each.pose.position[0] for each in found if each.pose is not None] == [0.0, 1.0, 2.0]


@pytest.mark.parametrize("place", [0, 2, 3])
def test_a_picture_with_a_stamp_of_another_clock_is_left_out_and_told(
    tmp_path: Path, place: int, caplog: pytest.LogCaptureFixture
) -> None:
    with bag(tmp_path / "a.mcap") as made:
        for k in range(4):
            at = T0 + k * SECOND // 10
            stamped(made, at + (1000 * SECOND if k == place else 0), at, 400.0 + 100.0 * k)
    found = list(read_depth(tmp_path / "a.mcap"))
    np.testing.assert_allclose([each.depth[5, 5] for each in found], np.delete([0.4, 0.5, 0.6, 0.7], place))
    assert max(each.time for each in found) < 1.0
    assert f"1 of 4 pictures are left out: their times go back, or jump, first that of {place + 1}" in caplog.text


def test_a_frame_without_stamps_is_told_by_when_it_was_recorded(tmp_path: Path) -> None:
    with bag(tmp_path / "a.mcap") as made:
        for k in range(3):
            at = T0 + k * SECOND
            stamped(made, 5 * SECOND + k * SECOND, at, 500.0)
            placed(made, 0, at, float(k))
    assert [each.pose.position[0] for each in read_depth(tmp_path / "a.mcap") if each.pose] == [0.0, 1.0, 2.0]


def test_frames_that_go_round_in_a_circle_end(tmp_path: Path) -> None:
    with bag(tmp_path / "a.mcap") as made:
        made.info(T0)
        made.transform(T0, "a", FRAME, TURN)
        made.transform(T0, FRAME, "a", TURN)
        made.image(T0, plane())
    assert first(tmp_path / "a.mcap").pose is None


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("no info", "has no CameraInfo beside it; record its camera_info, too"),
        ("other size", "has pictures of 64 x 48 and a CameraInfo of 32 x 24"),
        ("distorted", "has lens distortion; record the rectified depth"),
        ("uncalibrated", "is not calibrated"),
        ("colour", "has pictures of 'rgb8'; depth is 16UC1, mono16, 32FC1"),
        ("two", f"has depth on {DEPTH}, /other/depth: choose one by `topic`"),
        ("none", "has neither depth pictures nor clouds; its topics: /camera/depth/camera_info"),
        ("short", "a picture of 64 x 48 has 6000 bytes in rows of 128"),
        ("unrowed", "has clouds without rows, and there is no CameraInfo"),
        ("bent", "its clouds are not those of a pinhole in their own frame"),
        ("empty cloud", "a cloud with 0 points, and no CameraInfo beside it"),
    ],
)
def test_what_cannot_be_read_as_depth_is_one_line(tmp_path: Path, what: str, said: str) -> None:
    path = tmp_path / "a.mcap"
    with bag(path) as made:
        if what not in ("no info", "unrowed", "bent", "empty cloud"):
            lens = {"other size": (32, 24, *LENS[2:]), "uncalibrated": (64, 48, 0.0, 0.0, 0.0, 0.0)}.get(what, LENS)
            made.info(T0, lens, (0.1, 0, 0, 0, 0) if what == "distorted" else (0.0,) * 5)
        if what == "two":
            made.image(T0, plane(), topic="/other/depth")
        if what == "short":
            message = made.types.make(
                "sensor_msgs/msg/Image", header=made.types.header(T0, FRAME), height=48, width=64, encoding="16UC1",
                is_bigendian=0, step=128, data=np.zeros(6000, np.uint8))  # fmt: skip
            made.write(DEPTH, T0, message)
        elif what in ("unrowed", "bent", "empty cloud"):
            shape = points_of(plane(0.5))
            cloud = {"unrowed": shape.reshape(1, -1, 3), "bent": shape[..., ::-1], "empty cloud": shape * np.nan}[what]
            made.cloud(T0, cloud)
        elif what != "none":
            made.image(T0, plane(), "rgb8" if what == "colour" else "16UC1")
    with pytest.raises(ConfigError, match=said) as error:
        first(path)
    assert "\n" not in str(error.value)


def test_a_topic_that_is_not_there_is_answered_with_those_that_are(tmp_path: Path) -> None:
    with bag(tmp_path / "a.mcap") as made:
        made.info(T0)
        made.image(T0, plane())
    with pytest.raises(ConfigError, match=f"has no depth on {INFO}; pictures and clouds: {DEPTH}"):
        first(tmp_path / "a.mcap", topic=INFO)


def test_a_file_that_is_not_there_or_no_bag_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no bag at"):
        first(tmp_path / "none.mcap")
    (tmp_path / "text.mcap").write_text("no bag")
    with pytest.raises(RecordingError, match=r"text\.mcap: not a readable bag"):
        first(tmp_path / "text.mcap")
