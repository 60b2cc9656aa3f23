"""The camera check after the lift: in the hand, still where it stood, elsewhere on the table, or hidden."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from allegro_twin.cell.camera.camera import CameraFrame
from allegro_twin.cell.camera.intrinsics import Cloud
from allegro_twin.cell.checks.camera_check import CameraCheck, LiftedPart, check_camera, lifted_part
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.kinematics.pose import Pose
from allegro_twin.sim.objects.catalogue import GraspObject
from allegro_twin.types import Array
from benchmarks.tabletop import place_standing
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


def stack(above: float = 0.0, x: float = 0.02, y: float = -0.01) -> CameraFrame:
    """Two cans of 60 mm, one on the other; the upper is so much higher, and the lower at a place, m."""
    names = ("lower", "upper")
    lower, upper = (
        place_standing(GraspObject(name, "cylinder", (0.065, 0.06), 0.2), "z", 0.0, 0.02, -0.01) for name in names
    )
    lower = replace(lower, position=(x, y, lower.position[2]))
    return picture(lower, replace(upper, position=(0.02, -0.01, upper.position[2] + 0.06 + above)))


def part_of(frame: CameraFrame) -> LiftedPart | None:
    seen = look(stack())
    assert isinstance(seen, Detection)
    palms = (GRASPED, LIFTED)
    assert check_camera(frame, frame.cloud, seen, NONE, palms, LIFT, SEEN_BY).left
    return lifted_part(frame, frame.cloud, seen, NONE, palms, LIFT, SEEN_BY)


def test_the_upper_of_two_that_were_seen_as_one_is_known_as_the_part_that_was_lifted() -> None:
    part = part_of(stack(LIFT))
    assert part is not None
    np.testing.assert_allclose(part.found.solid.position, (0.02, -0.01, 0.09), atol=0.006)
    assert part.found.solid.shape == "cylinder"
    assert part.found.points[:, 2].min() > 0.05
    assert (part.sight.there, part.sight.gone, part.sight.left) == (True, True, "")
    assert part.sight.behind.startswith("a part of what was seen as one object stayed behind, at (")


def test_what_stands_whole_where_it_stood_has_no_lifted_part() -> None:
    assert part_of(stack()) is None
    sight = after(raised(0.0))
    assert (sight.incomplete, sight.behind) == (False, "")


@pytest.mark.parametrize("by", [0.03, 0.05])
def test_what_was_pushed_aside_and_stands_elsewhere_has_no_lifted_part(by: float) -> None:
    seen, palms = before(), (GRASPED, LIFTED)
    frame = picture(put("tomato_soup_can", x=0.02 + by))
    assert lifted_part(frame, frame.cloud, seen, NONE, palms, LIFT, SEEN_BY) is None


def test_where_the_rest_was_pushed_aside_the_camera_says_that_some_of_the_place_is_empty() -> None:
    frame = stack(LIFT, y=0.07)
    assert part_of(frame) is None
    seen = look(stack())
    assert isinstance(seen, Detection)
    sight = check_camera(frame, frame.cloud, seen, NONE, (GRASPED, LIFTED), LIFT, SEEN_BY)
    assert "where none was" in sight.left
    assert sight.incomplete
