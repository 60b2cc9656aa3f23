"""Hand-eye calibration: the camera is found, the error is stated, and what cannot be found is refused."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.cell.calibration.hand_eye import HandEyeCalibration, PatternView, calibrate_hand_eye
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.orientation import angle_between
from allegro_twin.kinematics.pose import Pose
from tests.cell.calibration.views import CAMERA, LENS, PATTERN, UNIT, pattern_views


def errors(found: HandEyeCalibration) -> tuple[float, float]:
    """Of the camera, m and rad."""
    far = float(np.linalg.norm(found.camera.position - CAMERA.position))
    return far, float(angle_between(found.camera.rotation, CAMERA.rotation))


@pytest.mark.parametrize("wrist", [True, False])
def test_from_exact_corners_camera_and_pattern_are_found_to_the_last_digits(wrist: bool) -> None:
    found = calibrate_hand_eye(pattern_views(1, 8, wrist=wrist, noise=0.0), LENS, at_the_wrist=wrist)
    assert max(errors(found)) < 1e-9
    np.testing.assert_allclose(found.pattern.position, PATTERN.position, atol=1e-9)
    np.testing.assert_allclose(found.pattern.rotation, PATTERN.rotation, atol=1e-9)
    assert found.residual < 1e-6
    assert found.position_error < 1e-8


@pytest.mark.slow
def test_pixel_noise_costs_tenths_of_a_millimetre_and_the_stated_error_covers_it() -> None:
    covered = 0
    for seed in range(10):
        found = calibrate_hand_eye(pattern_views(seed), LENS, at_the_wrist=True)
        far, turned = errors(found)
        assert far < 1e-3
        assert turned < np.radians(0.15)
        covered += far <= found.position_error and turned <= found.rotation_error
    assert covered >= 9


@pytest.mark.slow
def test_an_arm_that_is_off_by_a_tenth_of_a_millimetre_is_in_the_stated_error() -> None:
    exact = [calibrate_hand_eye(pattern_views(seed), LENS, at_the_wrist=True) for seed in range(5)]
    arm = (1e-4, np.radians(0.02))
    rough = [calibrate_hand_eye(pattern_views(seed, arm=arm), LENS, at_the_wrist=True) for seed in range(5)]
    assert np.mean([r.position_error for r in rough]) > 3.0 * np.mean([r.position_error for r in exact])
    assert sum(errors(r)[0] <= r.position_error for r in rough) >= 4


@pytest.mark.slow
def test_the_arms_own_errors_are_estimated_and_weighed_so_that_they_cost_little() -> None:
    arm = (1e-4, np.radians(0.02))
    found = [calibrate_hand_eye(pattern_views(seed, arm=arm), LENS, at_the_wrist=True) for seed in range(6)]
    assert np.mean([errors(each)[0] for each in found]) < 3e-4  # 0.16 mm; with an arm that is trusted 0.5 mm.
    assert 3e-5 <= np.median([each.arm_position for each in found]) <= 3.2e-4  # The grid has steps of 3.2.
    exact = calibrate_hand_eye(pattern_views(0), LENS, at_the_wrist=True)
    assert exact.arm_position <= 3.2e-5


def test_the_corners_are_as_far_off_as_they_were_drawn() -> None:
    found = calibrate_hand_eye(pattern_views(3, noise=0.1), LENS, at_the_wrist=True)
    assert found.residual == pytest.approx(0.1 * np.sqrt(2.0), rel=0.1)
    assert found.held_out > found.residual
    assert len(found.views) == 15
    assert found.views[0][0] == "00.png"


def test_too_few_pictures_are_refused() -> None:
    with pytest.raises(ConfigError, match="5 pictures show the pattern; hand-eye calibration needs 6, better 15"):
        calibrate_hand_eye(pattern_views(1, 5), LENS, at_the_wrist=True)


@pytest.mark.parametrize(
    ("name", "said"), [("01.png", r"01\.png is listed twice"), ("99.png", r"99\.png is the same picture as 01\.png")]
)
def test_a_picture_that_is_there_twice_is_refused_under_whatever_name(name: str, said: str) -> None:
    views = pattern_views(1, 5)
    with pytest.raises(ConfigError, match=f"{said}: a picture counts once"):
        calibrate_hand_eye([*views, views[1]._replace(name=name)], LENS, at_the_wrist=True)


def test_postures_that_hardly_turn_are_refused_with_the_turn_that_they_lack() -> None:
    with pytest.raises(ConfigError, match=r"the 15 postures turn by [0-3]\.\d° about a second axis, less than 8°"):
        calibrate_hand_eye(pattern_views(1, tilt=3.0), LENS, at_the_wrist=True)


def test_a_camera_that_only_rolls_about_its_axis_is_refused() -> None:
    with pytest.raises(ConfigError, match="tilted by some 30° about two axes"):
        calibrate_hand_eye(pattern_views(1, tilt=0.0), LENS, at_the_wrist=True)


def test_one_picture_with_the_pose_of_another_moment_is_named() -> None:
    views = pattern_views(1)
    moved = Pose(views[4].arm.position + np.array([0.01, 0.0, 0.0]), views[4].arm.rotation)
    views[4] = views[4]._replace(arm=moved)
    with pytest.raises(ConfigError, match=r"04\.png: its corners are .* take it anew or leave it out"):
        calibrate_hand_eye(views, LENS, at_the_wrist=True)


def mixed(views: list[PatternView]) -> list[PatternView]:
    """Each picture with the pose of the next."""
    return [view._replace(arm=views[k - 1].arm) for k, view in enumerate(views)]


@pytest.mark.slow
def test_poses_in_another_order_than_the_pictures_are_refused() -> None:
    with pytest.raises(ConfigError, match="arm and pictures disagree by .* pixels, more than 3"):
        calibrate_hand_eye(mixed(pattern_views(1)), LENS, at_the_wrist=True)


@pytest.mark.slow
def test_poses_of_the_base_in_the_flange_are_refused() -> None:
    views = [view._replace(arm=Pose(view.arm.rotation.T @ -view.arm.position, view.arm.rotation.T))
             for view in pattern_views(1)]  # fmt: skip
    with pytest.raises(ConfigError, match="are the poses those of the flange in the base"):
        calibrate_hand_eye(views, LENS, at_the_wrist=True)


@pytest.mark.slow
def test_a_camera_at_the_wrist_is_not_taken_for_one_that_stands_still() -> None:
    with pytest.raises(ConfigError, match="disagree"):
        calibrate_hand_eye(pattern_views(1), LENS, at_the_wrist=False)


def test_an_arm_that_stands_still_turns_by_nothing() -> None:
    views = [view._replace(arm=UNIT) for view in pattern_views(1)]
    with pytest.raises(ConfigError, match=r"turn by 0\.0°"):
        calibrate_hand_eye(views, LENS, at_the_wrist=True)


def larger(views: list[PatternView], square: float = 1.0, arm: float = 1.0) -> list[PatternView]:
    """With squares stated so many times as large, and positions of the arm."""
    return [
        view._replace(
            points=square * view.points, pattern=Pose(square * view.pattern.position, view.pattern.rotation),
            arm=Pose(arm * view.arm.position, view.arm.rotation),
        )
        for view in views
    ]  # fmt: skip


@pytest.mark.parametrize(("scale", "said"), [
    ({"arm": 1e3}, "the arm's positions are 1000 times as far apart as the pictures: they are in mm; state them in m"),
    ({"square": 1e3}, "the pattern is 1000 times as large as the pictures: its `square` is in mm; state it in m"),
])  # fmt: skip
@pytest.mark.parametrize("wrist", [True, False])
def test_poses_or_squares_in_millimetres_are_refused_in_a_sentence(
    wrist: bool, scale: dict[str, float], said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        calibrate_hand_eye(larger(pattern_views(1, 8, wrist=wrist), **scale), LENS, at_the_wrist=wrist)


@pytest.mark.parametrize("wrist", [True, False])
def test_squares_of_another_size_are_told_and_are_in_the_stated_error(wrist: bool) -> None:
    found = calibrate_hand_eye(larger(pattern_views(1, 8, wrist=wrist), square=32 / 35), LENS, at_the_wrist=wrist)
    (wrong,) = found.contradicted
    assert wrong.stated == "square"
    assert wrong.change[0] == pytest.approx(35 / 32, rel=2e-3)
    assert 0.02 < errors(found)[0] < found.position_error < 0.06
    assert np.linalg.norm(wrong.camera.position - CAMERA.position) < 1e-3


@pytest.mark.slow
def test_another_focal_length_is_told_and_is_in_the_stated_error() -> None:
    lens = LENS._replace(fx=1.02 * LENS.fx, fy=1.02 * LENS.fy)
    found = calibrate_hand_eye(pattern_views(1, 8), lens, at_the_wrist=True)
    (wrong,) = found.contradicted
    assert wrong.stated == "focal"
    assert wrong.change[0] == pytest.approx(1 / 1.02, rel=2e-3)
    assert 0.005 < errors(found)[0] < found.position_error < 0.015


@pytest.mark.parametrize("arm", [(0.0, 0.0), (1e-4, np.radians(0.02))])
def test_another_principal_point_is_told_as_such_and_is_in_the_stated_error(arm: tuple[float, float]) -> None:
    lens = LENS._replace(cx=LENS.cx + 5.0)
    found = calibrate_hand_eye(pattern_views(1, arm=arm), lens, at_the_wrist=True)
    (wrong,) = found.contradicted
    assert wrong.stated == "principal"
    np.testing.assert_allclose(wrong.change, [-5.0, 0.0], atol=0.3)
    assert np.radians(0.6) < errors(found)[1] < found.rotation_error < np.radians(1.1)
    assert angle_between(wrong.camera.rotation, CAMERA.rotation) < np.radians(0.1)


@pytest.mark.parametrize("arm", [(0.0, 0.0), (1e-3, 3e-3)])
def test_nothing_is_told_of_a_right_board_whatever_the_arm(arm: tuple[float, float]) -> None:
    assert calibrate_hand_eye(pattern_views(1, arm=arm), LENS, at_the_wrist=True).contradicted == ()
