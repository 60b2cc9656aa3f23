"""The hand's frame is the report's, does not turn for what is round, and keeps off the table."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from allegro_twin.cell.perception.errors import PerceptionRefusal
from allegro_twin.cell.perception.fits.model import Shape, Solid, half_width
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.perception.segmentation import TablePlane
from allegro_twin.cell.perception.settings import TargetSettings
from allegro_twin.cell.perception.target import GraspTarget, grasp_target, main_axis
from allegro_twin.types import Array

SETTINGS = TargetSettings(offset=0.05)
UP = np.array([0.0, 0.0, 1.0])


def about_z(turn: float) -> Array:
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def found(shape: Shape, size: tuple[float, float, float], axes: Array, height: float) -> Detection:
    solid = Solid(shape, np.array([0.1, -0.05, height]), axes, size, 0.0005)
    return Detection(solid, TablePlane(UP, 0.0, 0.9), np.zeros((1, 3)), 0.001, 0)


def aimed(seen: Detection, before: GraspTarget | None = None, **more: Any) -> GraspTarget:
    made = grasp_target(seen, SETTINGS.model_copy(update=more), before)
    assert isinstance(made, GraspTarget), made
    return made


def test_y_is_the_main_axis_z_goes_down_onto_it_and_the_frame_is_half_a_width_and_the_offset_away() -> None:
    can = found("cylinder", (0.1, 0.066, 0.066), about_z(0.6), 0.033)
    made = aimed(can)
    np.testing.assert_allclose(made.rotation[:, 1], [np.cos(0.6), np.sin(0.6), 0.0], atol=1e-12)
    np.testing.assert_allclose(made.rotation[:, 2], -UP, atol=1e-12)
    np.testing.assert_allclose(made.rotation[:, 0], np.cross(made.rotation[:, 1], made.rotation[:, 2]), atol=1e-12)
    np.testing.assert_allclose(made.position, [0.1, -0.05, 0.033 + 0.033 + 0.05], atol=1e-12)
    assert made.width == pytest.approx(0.066)
    assert np.linalg.det(made.rotation) == pytest.approx(1.0)


def test_where_the_main_axis_leans_z_is_the_vertical_across_it() -> None:
    lean = np.radians(30)
    axes = np.array([[np.cos(lean), 0.0, -np.sin(lean)], [0.0, 1.0, 0.0], [np.sin(lean), 0.0, np.cos(lean)]])
    made = aimed(found("cylinder", (0.2, 0.04, 0.04), axes, 0.1))
    expected = -(UP - (UP @ axes[:, 0]) * axes[:, 0])
    np.testing.assert_allclose(made.rotation[:, 2], expected / np.linalg.norm(expected), atol=1e-12)


def test_where_the_main_axis_is_upright_the_fallback_takes_the_verticals_part() -> None:
    axes = np.stack([UP, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], axis=1)
    made = aimed(found("cylinder", (0.2, 0.07, 0.07), axes, 0.1))
    np.testing.assert_allclose(np.abs(made.rotation[:, 1]), UP, atol=1e-12)
    np.testing.assert_allclose(made.rotation[:, 2], [0.0, -1.0, 0.0], atol=1e-12)  # The report's: world y.
    np.testing.assert_allclose(made.position, [0.1, -0.05 + 0.035 + 0.05, 0.1], atol=1e-12)
    other = aimed(found("cylinder", (0.2, 0.07, 0.07), axes, 0.1), fallback=(-1.0, 0.0, 0.0))
    np.testing.assert_allclose(other.rotation[:, 2], [1.0, 0.0, 0.0], atol=1e-12)


def test_a_balls_frame_never_turns_whatever_its_axes_say() -> None:
    turns = [aimed(found("sphere", (0.06, 0.06, 0.06), about_z(turn), 0.03)).rotation for turn in (0.0, 0.4, 2.0)]
    for turn in turns:
        np.testing.assert_allclose(turn, turns[0], atol=1e-12)
    np.testing.assert_allclose(turns[0][:, 1], [0.0, 1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("flip", [1.0, -1.0])
def test_a_frame_stays_on_the_side_on_which_it_was(flip: float) -> None:
    axes = np.diag([1.0, flip, flip]) @ about_z(0.0)
    before = aimed(found("box", (0.2, 0.05, 0.05), about_z(3.0), 0.025))
    turned = axes * [flip, 1.0, flip]
    made = aimed(found("box", (0.2, 0.05, 0.05), turned, 0.025), before)
    assert made.rotation[:, 1] @ before.rotation[:, 1] > 0.9


def test_of_a_cubes_edges_the_main_one_is_level_and_the_nearest_to_what_it_was() -> None:
    cube = found("box", (0.0573, 0.057, 0.0568), about_z(0.2)[:, [2, 0, 1]], 0.0285)
    assert abs(main_axis(cube.solid, np.array([0.0, 1.0, 0.0])) @ UP) < 1e-9
    before = aimed(found("box", (0.0573, 0.057, 0.0568), about_z(0.1), 0.0285))
    made = aimed(cube, before)
    assert made.rotation[:, 1] @ before.rotation[:, 1] > 0.99


def test_a_flat_can_is_taken_from_above_across_its_axis() -> None:
    axes = np.stack([UP, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], axis=1)
    made = aimed(found("cylinder", (0.033, 0.085, 0.085), axes, 0.0165))
    np.testing.assert_allclose(made.rotation[:, 1], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(made.rotation[:, 2], -UP, atol=1e-12)
    assert made.width == pytest.approx(0.085)
    lying = np.stack([[1.0, 0.0, 0.0], UP, [0.0, -1.0, 0.0]], axis=1)
    wheel = aimed(found("cylinder", (0.033, 0.085, 0.085), lying, 0.0425))
    np.testing.assert_allclose(wheel.rotation[:, 1], [0.0, 1.0, 0.0], atol=1e-12)
    assert wheel.width == pytest.approx(0.033)


def test_a_target_in_or_near_the_table_is_refused_with_its_height() -> None:
    axes = np.stack([UP, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], axis=1)
    short = grasp_target(found("cylinder", (0.03, 0.02, 0.02), axes, 0.015), SETTINGS)
    assert isinstance(short, PerceptionRefusal)
    assert short.reason == "in_table"
    assert "0.015 m above the table" in str(short)
    assert "\n" not in str(short)
    sunk = grasp_target(found("sphere", (0.06, 0.06, 0.06), np.eye(3), -0.2), SETTINGS)
    assert isinstance(sunk, PerceptionRefusal)


@pytest.mark.parametrize(
    ("shape", "direction", "half"),
    [
        ("sphere", (1.0, 1.0, 1.0), 0.1),
        ("cylinder", (1.0, 0.0, 0.0), 0.1),
        ("cylinder", (0.0, 1.0, 1.0), 0.03),
        ("cylinder", (1.0, 1.0, 0.0), (0.1 + 0.03) / np.sqrt(2)),
        ("box", (0.0, 1.0, 1.0), (0.03 + 0.02) / np.sqrt(2)),
        ("ellipsoid", (1.0, 1.0, 0.0), np.sqrt((0.1**2 + 0.03**2) / 2)),
    ],
)
def test_how_far_a_solid_reaches_in_a_direction(shape: Shape, direction: tuple[float, ...], half: float) -> None:
    size = {"sphere": (0.2, 0.2, 0.2), "box": (0.2, 0.06, 0.04)}.get(shape, (0.2, 0.06, 0.06))
    unit = np.array(direction) / np.linalg.norm(direction)
    assert half_width(Solid(shape, np.zeros(3), np.eye(3), size, 0.0), unit) == pytest.approx(half)
