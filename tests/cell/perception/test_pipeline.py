"""What a camera sees on a table is named and placed; what cannot be grasped is refused with a sentence."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest

from allegro_twin.cell.camera.camera import CameraFrame, DepthCamera
from allegro_twin.cell.camera.mount import CameraMount
from allegro_twin.cell.camera.settings import DepthCameraSettings, DepthNoise
from allegro_twin.cell.perception.cloud import Points
from allegro_twin.cell.perception.errors import PerceptionRefusal
from allegro_twin.cell.perception.pipeline import Detection, PerceptionPipeline
from allegro_twin.cell.perception.settings import PerceptionSettings
from allegro_twin.cell.perception.target import GraspTarget, grasp_target
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings, parse_settings
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.sim.objects.catalogue import GraspObject, PlacedObject, load_object
from benchmarks.perception import apart
from benchmarks.tabletop import compile_tabletop, place_standing

SETTINGS = load_settings(PerceptionSettings, data_root() / "conf" / "perception" / "table.yaml")
EYE = (-0.36, 0.05, 0.38)


def picture(
    *things: PlacedObject, eye: tuple[float, float, float] = EYE, towards: tuple[float, float, float] = (0.0, 0.0, 0.03)
) -> CameraFrame:
    model, data = compile_tabletop(list(things))
    try:
        camera = DepthCamera(model, DepthCameraSettings(mount=CameraMount(position=eye, towards=towards)), seed=3)
    except ConfigError as error:
        pytest.skip(str(error))
    frame = camera.capture(data)
    camera.close()
    return frame


def look(frame: CameraFrame, settings: PerceptionSettings = SETTINGS) -> Detection | PerceptionRefusal:
    return PerceptionPipeline(settings).detect(frame.cloud, frame.pose.position, frame.pose.rotation)


def put(name: str, up: str = "z", yaw: float = 0.4, x: float = 0.02, y: float = -0.01) -> PlacedObject:
    return place_standing(load_object(name), up, yaw, x, y)


@pytest.mark.parametrize(
    ("name", "up"),
    [
        ("tomato_soup_can", "z"),
        ("mug", "x"),
        ("sugar_box", "y"),
        ("foam_brick", "z"),
        ("golf_ball", "z"),
        ("lemon", "z"),
    ],
)
def test_a_thing_on_the_table_is_named_and_placed_to_3_mm_and_5_degrees(name: str, up: str) -> None:
    placed = put(name, up)
    frame = picture(placed)
    found = look(frame)
    assert isinstance(found, Detection), found
    assert found.solid.shape == placed.grasp_object.shape
    assert np.linalg.norm(found.solid.position - placed.position) < 0.003
    if placed.grasp_object.shape != "sphere":
        assert apart(placed.grasp_object, matrix_from_quaternion(placed.quaternion), found.solid) < 5.0
    assert abs(found.table.offset) < 0.001
    assert found.others == 0
    assert isinstance(grasp_target(found, SETTINGS.target), GraspTarget)


def test_a_large_box_seen_from_near_is_no_cylinder_of_which_one_end_is_seen() -> None:
    placed = put("cracker_box", "z", -0.782, 0.043, -0.079)
    found = look(picture(placed, eye=(0.213, 0.131, 0.327), towards=(0.0, 0.0, 0.04)))
    assert isinstance(found, Detection), found
    assert found.solid.shape == "box"
    assert np.linalg.norm(found.solid.position - placed.position) < 0.004


def test_the_same_picture_has_the_same_answer_and_may_be_told_in_doubles() -> None:
    frame = picture(put("rubiks_cube"))
    first, second = look(frame), look(frame)
    assert isinstance(first, Detection)
    assert isinstance(second, Detection)
    np.testing.assert_array_equal(first.solid.position, second.solid.position)
    double = PerceptionPipeline(SETTINGS).detect(
        frame.cloud.astype(np.float64), frame.pose.position, frame.pose.rotation
    )
    assert isinstance(double, Detection)
    np.testing.assert_allclose(double.solid.position, first.solid.position, atol=0.002)


def test_of_things_apart_the_largest_is_taken_and_the_others_are_counted() -> None:
    found = look(picture(put("mug", x=0.0, y=0.08), put("golf_ball", x=-0.05, y=-0.08)))
    assert isinstance(found, Detection)
    assert found.solid.shape == "cylinder"
    assert found.others == 1


def test_a_small_thing_that_is_seen_within_the_rows_and_columns_of_a_large_one_does_not_count() -> None:
    box = put("cracker_box", "x", 0.785, x=0.0, y=0.0)
    found = look(picture(box, put("golf_ball", x=-0.11, y=0.11)))
    assert isinstance(found, Detection), found
    assert found.others == 1
    assert np.linalg.norm(found.solid.position - box.position) < 0.003
    assert (np.linalg.norm(found.points[:, :2] - [-0.11, 0.11], axis=1) > 0.025).all()


@pytest.mark.parametrize("name", ["pudding_box", "potted_meat_can"])
def test_a_level_top_that_is_seen_flatly_does_not_fall_apart(name: str) -> None:
    placed = put(name, "z", 0.0)
    found = look(picture(placed, eye=(-0.5, 0.0, 0.24)))
    assert isinstance(found, Detection), found
    assert np.linalg.norm(found.solid.position - placed.position) < 0.004


@pytest.mark.slow
def test_what_is_the_robots_own_is_no_thing() -> None:
    finger = PlacedObject(load_object("golf_ball"), (-0.12, 0.0, 0.15), (1.0, 0.0, 0.0, 0.0))
    frame = picture(put("rubiks_cube"), finger)
    near = PerceptionPipeline(SETTINGS)
    seen = near.detect(frame.cloud, frame.pose.position, frame.pose.rotation)
    assert isinstance(seen, PerceptionRefusal) or seen.others == 1
    own = np.array([[*finger.position, 0.03], [0.0, 0.3, 0.3, 0.02]])
    found = near.detect(frame.cloud, frame.pose.position, frame.pose.rotation, own)
    assert isinstance(found, Detection), found
    assert found.solid.shape == "box"
    assert found.others == 0
    with pytest.raises(ConfigError, match=r"balls \(k, 4\)"):
        near.detect(frame.cloud, frame.pose.position, frame.pose.rotation, np.zeros((2, 3)))


def said(answer: Detection | PerceptionRefusal, reason: str) -> str:
    assert isinstance(answer, PerceptionRefusal), answer
    assert answer.reason == reason
    assert "\n" not in str(answer)
    assert ";" in str(answer), "What, and what to do."
    return str(answer)


def test_a_camera_that_sees_no_table_says_so() -> None:
    away = picture(put("mug"), towards=(-1.0, 0.0, 0.9))
    assert "uncover its lens" in said(look(away), "empty")
    high = SETTINGS.model_copy(update={"region": SETTINGS.region.model_copy(update={"lower": (-0.4, -0.4, 0.02)})})
    sentence = said(look(picture(put("cracker_box", "z", 0.0)), high), "no_plane")
    assert "turn the camera towards" in sentence
    strict = SETTINGS.model_copy(update={"table": SETTINGS.table.model_copy(update={"part": 0.99})})
    assert "99% make one" in said(look(picture(put("mug")), strict), "no_plane")
    gone = SETTINGS.model_copy(update={"region": SETTINGS.region.model_copy(update={"lower": (-0.4, -0.4, 0.4)})})
    assert "are in the region" in said(look(picture(put("mug")), gone), "no_plane")


def test_an_empty_table_and_an_empty_cloud_say_so() -> None:
    assert "put a thing into the region" in said(look(picture()), "no_object")
    nothing = np.full((480, 640, 3), np.nan, np.float32)
    assert "0 of " in said(PerceptionPipeline(SETTINGS).detect(nothing, np.zeros(3), np.eye(3)), "empty")


def test_what_is_not_seen_below_the_noise_is_told_with_the_height_that_noise_asks_for() -> None:
    noisy = SETTINGS.model_copy(update={"disparity": 2.0})
    sentence = said(look(picture(put("apple")), noisy), "no_object")
    asked = re.search(r"higher than (\S+) m and seen, for `perception.disparity` 2 ", sentence)
    assert asked is not None, sentence
    assert float(asked[1]) > 0.07, "The apple is 7 cm high."
    assert sentence.endswith("put a thing into the region, or bring the camera nearer")
    exact = SETTINGS.model_copy(update={"disparity": 0.0})
    assert "higher than 0.006 m and seen; " in said(look(picture(), exact), "no_object")


def test_what_is_seen_by_too_few_points_is_named_with_its_place_and_is_not_nothing() -> None:
    cube = place_standing(GraspObject("cube", "box", (0.016, 0.016, 0.016), 0.01), "z", 0.0, 0.1, 0.1)
    frame = picture(put("mug", x=0.0, y=-0.05), cube)
    found = PerceptionPipeline(SETTINGS).detect_all(frame.cloud, frame.pose.position, frame.pose.rotation)
    assert [isinstance(each, Detection) for each in found] == [True, False]
    sentence = said(found[1], "small")
    assert re.match(r"something at \((0.09|0.10)\d, (0.09|0.10)\d, 0.01\d\) is too small", sentence), sentence
    assert "`perception.object.least`" in sentence
    assert said(look(picture(cube)), "small")


@pytest.mark.parametrize(("by", "what"), [(0.03, "30 mm higher"), (-0.04, "40 mm lower"), (0.004, "")])
def test_a_table_that_is_not_at_the_cells_height_is_refused_with_the_difference(by: float, what: str) -> None:
    frame = picture(put("mug"))
    eye = frame.pose.position + np.array([0.0, 0.0, by])
    seen = PerceptionPipeline(SETTINGS).detect(frame.cloud, eye, frame.pose.rotation)
    if not what:
        assert isinstance(seen, Detection)
        return
    assert f"the table stands {what} than the cell's, z = 0" in said(seen, "table")
    anywhere = SETTINGS.model_copy(update={"table": SETTINGS.table.model_copy(update={"off": None})})
    free = PerceptionPipeline(anywhere).detect(frame.cloud, eye, frame.pose.rotation)
    assert isinstance(free, Detection) or free.reason == "outside"


def test_a_camera_that_is_turned_from_where_the_cell_has_it_shows_in_the_tables_height() -> None:
    frame, turn = picture(put("mug")), np.radians(3.0)
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(turn), -np.sin(turn)], [0.0, np.sin(turn), np.cos(turn)]])
    seen = PerceptionPipeline(SETTINGS).detect(frame.cloud, frame.pose.position, tilt @ frame.pose.rotation)
    assert re.search(r"stands 1\d mm (higher|lower)", said(seen, "table"))


def test_a_camera_that_is_noisier_than_told_shows_in_the_tables_scatter() -> None:
    def seen(disparity: float) -> Detection | PerceptionRefusal:
        model, data = compile_tabletop([put("mug")])
        mount, noise = CameraMount(position=EYE, towards=(0.0, 0.0, 0.03)), DepthNoise(disparity=disparity)
        camera = DepthCamera(model, DepthCameraSettings(mount=mount, noise=noise), seed=3)
        frame = camera.capture(data)
        camera.close()
        return look(frame)

    assert isinstance(seen(0.08), Detection)
    sentence = said(seen(0.35), "table")
    assert "noisier than `perception.disparity` says, 0.08" in sentence


def test_the_larger_one_of_two_things_that_touch_is_found() -> None:
    found = look(picture(put("pudding_box", x=0.0), put("tomato_soup_can", x=0.035, y=0.065)))
    assert isinstance(found, Detection), found
    assert found.solid.shape == "box"
    np.testing.assert_allclose(found.solid.size, (0.11, 0.089, 0.035), atol=0.003)
    assert found.others == 1


HEAP = [("golf_ball", 0.0, 0.0), ("lemon", 0.05, 0.0), ("foam_brick", -0.01, 0.055), ("tuna_fish_can", 0.07, 0.06),
        ("peach", -0.055, -0.01), ("rubiks_cube", 0.02, -0.05)]  # fmt: skip


@pytest.mark.slow
def test_a_heap_is_unclear_or_taken_for_about_one_solid_where_that_is_allowed() -> None:
    heap = picture(*(put(name, x=x, y=y) for name, x, y in HEAP))
    assert "move them 2 cm apart" in said(look(heap), "unclear")
    loose = SETTINGS.model_copy(update={"object": SETTINGS.object.model_copy(update={"loose": 0.05})})
    assert isinstance(look(heap, loose), Detection)


def test_what_is_seen_too_flatly_says_from_where_to_look() -> None:
    answer = look(picture(put("wood_block"), eye=(-0.5, 0.05, 0.16)))
    assert "the top is not seen" in said(answer, "unclear")
    two = look(picture(put("mug"), put("apple", x=0.02, y=0.07), eye=(-0.5, 0.05, 0.22)))
    assert "look from 30° or more" in said(two, "unclear")


def test_a_thing_out_of_the_workspace_is_named_with_its_place() -> None:
    sentence = said(look(picture(put("mug", x=0.3, y=0.0))), "outside")
    assert "the cylinder at (0.29" in sentence or "the cylinder at (0.30" in sentence


def test_a_thing_that_is_cut_off_is_not_guessed_at() -> None:
    assert "edge" in said(look(picture(put("mug"), towards=(0.0, 0.33, 0.03))), "cut_off")
    narrow = SETTINGS.region.model_copy(update={"upper": (0.4, 0.0, 0.5)})
    assert "along y" in said(look(picture(put("mug")), SETTINGS.model_copy(update={"region": narrow})), "cut_off")


def test_points_that_are_not_known_in_part_are_left_out() -> None:
    frame = picture(put("tennis_ball"))
    torn = frame.cloud.copy()
    draws = np.random.default_rng(0)
    torn[draws.random(torn.shape) < 0.05] = np.nan
    torn[::17, ::13] = np.inf
    answer = PerceptionPipeline(SETTINGS).detect(torn, frame.pose.position, frame.pose.rotation)
    assert isinstance(answer, Detection), answer
    assert answer.solid.shape == "sphere"


@pytest.mark.parametrize(
    ("cloud", "says"),
    [
        (np.zeros((100, 3), np.float32), r"\(rows, columns, 3\) floats, not \(100, 3\)"),
        (np.zeros((10, 10, 3), np.int64), "int64"),
    ],
)
def test_a_cloud_of_another_shape_is_an_error(cloud: Points, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        PerceptionPipeline(SETTINGS).detect(cloud, np.zeros(3), np.eye(3))


def test_a_pose_that_is_not_known_and_a_cloud_without_order_are_errors() -> None:
    frame = picture(put("mug"))
    with pytest.raises(ConfigError, match="not finite"):
        PerceptionPipeline(SETTINGS).detect(frame.cloud, np.full(3, np.nan), np.eye(3))
    with pytest.raises(ConfigError, match="as the camera's picture is ordered"):
        PerceptionPipeline(SETTINGS).detect(frame.cloud[:, ::-1], frame.pose.position, frame.pose.rotation)


def test_without_scipy_perception_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy", None)
    monkeypatch.setitem(sys.modules, "scipy.ndimage", None)
    with pytest.raises(ConfigError, match=r"pip install 'allegro-twin\[lab\]'"):
        PerceptionPipeline(SETTINGS)


def test_settings_name_what_is_wrong_in_them() -> None:
    with pytest.raises(ConfigError, match="every upper bound is the greater"):
        parse_settings(PerceptionSettings, {"region": {"lower": [0, 0, 0], "upper": [1, 0, 1]}}, "here.yaml")
    with pytest.raises(ConfigError, match="did you mean 'stride'"):
        parse_settings(PerceptionSettings, SETTINGS.model_dump() | {"strid": 2}, "here.yaml")
