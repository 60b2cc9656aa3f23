"""Calibration patterns: their corners are found in a picture, however it is turned, and nothing else is."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from pydantic import ValidationError

from allegro_twin.cell.calibration.hand_eye import PatternView
from allegro_twin.cell.calibration.pattern import Grey, PatternSettings, draw_pattern, find_pattern, printed_size
from allegro_twin.cell.camera.intrinsics import Intrinsics
from allegro_twin.errors import ConfigError
from tests.cell.calibration.views import UNIT

CHECKERS = PatternSettings(kind="checkerboard", columns=7, rows=6)
NONE = np.zeros(0)


def lens_of(picture: Grey) -> Intrinsics:
    high, wide = picture.shape
    return Intrinsics(wide, high, 800.0, 800.0, (wide - 1) / 2, (high - 1) / 2)


def find(picture: Grey, pattern: PatternSettings) -> PatternView | None:
    return find_pattern(np.ascontiguousarray(picture), pattern, lens_of(picture), NONE, name="a.png", arm=UNIT)


@pytest.mark.parametrize("pattern", [PatternSettings(), CHECKERS])
@pytest.mark.parametrize("turns", range(4))
def test_corners_are_where_they_were_drawn_however_the_picture_is_turned(pattern: PatternSettings, turns: int) -> None:
    square = 40
    view = find(np.rot90(draw_pattern(pattern, square), turns), pattern)
    assert view is not None
    assert len(view.points) == (pattern.columns - 1) * (pattern.rows - 1)
    high, wide = draw_pattern(pattern, square).shape
    at = view.points[:, :2] / pattern.square * square + square / 2 - 0.5
    for _ in range(turns):  # As rot90: a pixel of column u and row v goes to column v and row wide - 1 - u.
        at = np.stack([at[:, 1], wide - 1 - at[:, 0]], axis=1)
        high, wide = wide, high
    assert np.abs(view.pixels - at).max() < 0.3


@pytest.mark.parametrize("pattern", [PatternSettings(), CHECKERS])
def test_a_pattern_straight_ahead_has_the_cameras_axes_and_its_distance(pattern: PatternSettings) -> None:
    picture = draw_pattern(pattern, 40)
    view = find(picture, pattern)
    assert view is not None
    np.testing.assert_allclose(view.pattern.rotation, np.eye(3), atol=0.01)
    assert view.pattern.position[2] == pytest.approx(800.0 * pattern.square / 40, rel=0.01)


def test_a_picture_without_the_pattern_shows_none() -> None:
    assert find(np.full((200, 300), 128, np.uint8), PatternSettings()) is None
    assert find(np.full((200, 300), 128, np.uint8), CHECKERS) is None


def test_a_charuco_pattern_that_is_half_hidden_is_still_known() -> None:
    picture = draw_pattern(PatternSettings(), 40)
    picture[:, :140] = 90
    view = find(picture, PatternSettings())
    assert view is not None
    assert 8 <= len(view.points) < 24
    assert view.points[:, 0].min() > 0.1


def test_one_row_of_corners_is_too_little() -> None:
    picture = draw_pattern(PatternSettings(columns=20, rows=3), 40)
    picture[80:] = 90
    assert find(picture, PatternSettings(columns=20, rows=3)) is None


def test_a_picture_of_another_size_is_refused() -> None:
    picture = draw_pattern(PatternSettings(), 40)
    other = lens_of(picture)._replace(width=640)
    with pytest.raises(ConfigError, match=r"a\.png has 320 x 240 pixels; its intrinsics are of 640 x 240"):
        find_pattern(picture, PatternSettings(), other, NONE, name="a.png", arm=UNIT)


def test_distortion_is_taken_out_of_the_corners() -> None:
    picture = draw_pattern(PatternSettings(), 40)
    plain = find(picture, PatternSettings())
    bent = find_pattern(
        picture, PatternSettings(), lens_of(picture), np.array([0.2, 0.0, 0.0, 0.0]), name="a.png", arm=UNIT
    )
    assert plain is not None
    assert bent is not None
    lens = lens_of(picture)
    ideal = (bent.pixels - [lens.cx, lens.cy]) / lens.fx
    again = ideal * (1.0 + 0.2 * (ideal**2).sum(axis=1, keepdims=True)) * lens.fx + [lens.cx, lens.cy]
    np.testing.assert_allclose(again, plain.pixels, atol=1e-3)
    assert np.abs(bent.pixels - plain.pixels).max() > 0.3


def test_the_print_has_half_a_square_of_margin() -> None:
    picture, (wide, high) = draw_pattern(PatternSettings(), 40), printed_size(PatternSettings())
    assert picture.shape == (240, 320)
    assert (wide, high) == pytest.approx((0.28, 0.21))
    assert (picture[:20] == 255).all()
    assert picture[25, 25] == 0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"kind": "checkerboard", "columns": 7, "rows": 5}, "looks the same upside down"),
        ({"marker": 0.04}, "marker 0.04 m must be smaller than square 0.035 m"),
    ],
)
def test_a_pattern_that_cannot_be_is_refused(given: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        PatternSettings.model_validate(given)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"dictionary": "DICT_9X9_50"}, "OpenCV has no dictionary 'DICT_9X9_50'"),
        ({"columns": 12, "rows": 10}, "DICT_4X4_50 has 50 markers; 12 x 10 squares need 60"),
    ],
)
def test_a_dictionary_that_does_not_fit_is_refused(given: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        draw_pattern(PatternSettings.model_validate(given), 20)


def test_without_opencv_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(ConfigError, match=r"pip install 'allegro-twin\[calibration\]'"):
        draw_pattern(PatternSettings(), 20)
