"""The camera check after the lift: in the hand, still where it stood, elsewhere on the table, or hidden."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from allegro_twin.cell.camera.camera import CameraFrame
from allegro_twin.cell.camera.intrinsics import Cloud
from allegro_twin.cell.checks.camera_check import CameraCheck, check_camera
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import Array
from tests.cell.perception.test_pipeline import SETTINGS as SEEN_BY
from tests.cell.perception.test_pipeline import look, picture, put

LIFT = 0.15
GRASPED = Pose(np.array([0.0, 0.0, 0.2]), np.eye(3))
LIFTED = Pose(np.array([0.0, 0.0, 0.2 + LIFT]), np.eye(3))
NONE = np.empty((0, 3))


def before() -> Detection:
    seen = look(picture(put("tomato_soup_can")))
    assert isinstance(seen, Detection)
    return seen


def after(frame: CameraFrame, cloud: Cloud | None = None, others: Array = NONE) -> CameraCheck:
    shown = frame.cloud if cloud is None else cloud
    return check_camera(frame, shown, before(), others, (GRASPED, LIFTED), LIFT, SEEN_BY)


def raised(by: float) -> CameraFrame:
    placed = put("tomato_soup_can")
    x, y, z = placed.position
    return picture(replace(placed, position=(x, y, z + by)))


def test_an_object_that_is_where_the_palm_took_it_is_seen_in_the_hand() -> None:
    for shift in (-0.015, 0.0, 0.015):
        sight = after(raised(LIFT + shift))
        assert (sight.held, sight.there, sight.gone, sight.left) == (True, True, True, "")


@pytest.mark.parametrize(("by", "held"), [(0.08, True), (0.0, False)])
def test_a_tall_side_that_covers_itself_after_a_short_lift_is_not_taken_for_one_that_was_not_lifted(
    by: float, held: bool
) -> None:
    box = put("cracker_box", "z", 0.0)
    seen = look(picture(box))
    assert isinstance(seen, Detection)
    x, y, z = box.position
    frame = picture(replace(box, position=(x, y, z + by)))
    palm = Pose(np.array([0.0, 0.0, 0.28]), np.eye(3))
    assert check_camera(frame, frame.cloud, seen, NONE, (GRASPED, palm), 0.08, SEEN_BY).held is held


def test_an_object_that_stands_where_it_stood_was_not_lifted() -> None:
    sight = after(raised(0.0))
    assert sight.held is False
    assert "the camera sees it where it stood, at (0.02" in sight.left


@pytest.mark.parametrize(("x", "y"), [(0.1, 0.0), (0.0, -0.1), (-0.08, 0.1)])
def test_an_object_that_fell_elsewhere_is_seen_on_the_table(x: float, y: float) -> None:
    left = after(picture(put("tomato_soup_can", x=x, y=y))).left
    assert left.startswith("the camera sees an object on the table at (")
    assert "where none was; what was to be taken stood at (0.02" in left


def test_an_object_that_stood_beside_it_before_is_not_taken_for_it() -> None:
    beside = picture(put("golf_ball", x=0.1, y=0.1))
    seen = look(beside)
    assert isinstance(seen, Detection)
    assert after(beside).held is False
    assert after(beside, others=seen.points).held is None


def test_an_empty_table_says_that_it_is_gone_and_not_where() -> None:
    sight = after(picture())
    assert (sight.held, sight.gone) == (None, True)


def test_what_the_hand_hides_is_not_told() -> None:
    frame = raised(LIFT)
    sight = after(frame, np.full_like(frame.cloud, np.nan))
    assert (sight.held, sight.gone) == (None, False)
