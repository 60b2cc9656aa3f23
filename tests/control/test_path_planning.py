"""A way is clear from end to end, the same every time, and none is invented where there is none."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allegro_twin.control.path_planning import (
    CLEARANCE,
    PlanningSpace,
    _back_out,
    _shorten,
    _Tree,
    crossing_pairs,
    is_clear,
    plan_path,
    postures_on_line,
)
from allegro_twin.types import Array, Vector

RADIUS = 0.02  # m. Two round fingers in a plane, 0.1 m a radian: joints 0 and 1 place one, 2 and 3 the other.


def apart(postures: Array, wall: bool = False) -> Array:
    """Between the two, and from each to a wall across the middle of the room if there is one."""
    places = 0.1 * np.asarray(postures)
    between = np.linalg.norm(places[:, :2] - places[:, 2:], axis=1) - 2 * RADIUS
    to_wall = np.abs(places[:, ::2]).min(axis=1) - RADIUS
    columns = [between, to_wall] if wall else [between]
    seen: Array = np.minimum(np.stack(columns, axis=1), 0.01)
    return seen


def walled(postures: Array) -> Array:
    return apart(postures, wall=True)


def room(wall: bool = False) -> PlanningSpace:
    return PlanningSpace(walled if wall else apart, [(0, 1), (2, 3)], np.zeros(4), np.full(4, -1.0), np.ones(4))


def along(rows: list[Vector]) -> Array:
    """Postures 1 mrad apart."""
    legs = [np.linspace(a, b, max(int(np.abs(b - a).max() / 1e-3), 2)) for a, b in pairwise(rows)]
    return np.concatenate(legs)


LEFT_RIGHT = np.array([-0.5, 0.0, 0.5, 0.0])
RIGHT_LEFT = np.array([0.5, 0.0, -0.5, 0.0])


def test_where_nothing_is_in_the_way_it_is_the_straight_line() -> None:
    goal = LEFT_RIGHT + np.array([0.0, 0.8, 0.0, 0.8])
    (only,) = plan_path(room(), LEFT_RIGHT, goal) or []
    np.testing.assert_array_equal(only, goal)


def test_two_that_change_places_go_round_each_other() -> None:
    found = plan_path(room(), LEFT_RIGHT, RIGHT_LEFT)
    assert found is not None
    assert len(found) > 1
    np.testing.assert_array_equal(found[-1], RIGHT_LEFT)
    assert apart(along([LEFT_RIGHT, *found])).min() >= CLEARANCE - 5e-4


def test_the_same_question_has_the_same_answer() -> None:
    first, second = (plan_path(room(), LEFT_RIGHT, RIGHT_LEFT) for _ in range(2))
    np.testing.assert_array_equal(np.array(first), np.array(second))


def test_what_touches_at_the_start_comes_apart_first_and_what_touches_at_the_goal_last() -> None:
    """The two lean on each other, 1 mm deep, at both ends, with their places changed."""
    touching, changed = np.array([-0.195, 0.0, 0.195, 0.0]), np.array([0.195, 0.0, -0.195, 0.0])
    found = plan_path(room(), touching, changed)
    assert found is not None
    seen = apart(along([touching, *found]))[:, 0]
    clear_of = np.flatnonzero(seen >= CLEARANCE)
    assert (np.diff(seen[: clear_of[0]]) > -3e-4).all()
    assert (np.diff(seen[clear_of[-1] :]) < 3e-4).all()
    assert seen[clear_of[0] : clear_of[-1]].min() >= CLEARANCE - 5e-4


def test_no_way_is_found_where_there_is_none() -> None:
    """A wall stands between a finger and where it should be."""
    start, goal = np.array([-0.6, 0.0, 0.6, 0.0]), np.array([0.6, 0.9, 0.9, -0.9])
    assert plan_path(room(wall=True), start, goal) is None


def test_a_start_that_cannot_come_apart_has_no_way() -> None:
    """1 mm deep wherever one goes, and deeper in between."""

    def pressed(rows: Array) -> Array:
        return np.where(np.abs(rows[:, :1]) < 0.2, -0.005, -0.001)

    stuck = PlanningSpace(pressed, [(0, 1), (2, 3)], np.zeros(4), np.full(4, -1.0), np.ones(4))
    assert plan_path(stuck, LEFT_RIGHT, RIGHT_LEFT) is None


places = st.tuples(*[st.floats(-0.9, 0.9)] * 4).map(np.array)


@settings(max_examples=40, deadline=None)
@given(places, places)
def test_every_way_that_is_found_is_clear_between_clear_ends(start: Vector, goal: Vector) -> None:
    if apart(np.array([start, goal])).min() < CLEARANCE:
        return
    found = plan_path(room(), start, goal)
    assert found is not None
    assert (np.abs(np.array(found)) <= 1.0).all()
    assert apart(along([start, *found])).min() >= CLEARANCE - 5e-4  # The grain, and what counts as noise.


@pytest.mark.parametrize(
    ("distances", "is_clear"),
    [
        ([9, 9, 9], True),
        ([9, 2, 9], False),
        ([-1, 1, 2, 9], True),
        ([9, 2, 0, -1], True),
        ([-1, 1, -1, 9], False),
        ([1, 9, 1], True),
        ([1, 2.9, 2.9, 1], True),
    ],
)
def test_a_pair_may_come_apart_and_together_but_not_together_and_apart(distances: list[float], is_clear: bool) -> None:
    assert crossing_pairs(np.array(distances)[:, None] * 1e-3, 0.003).tolist() == [not is_clear]


def test_a_thin_thing_in_the_middle_of_a_line_is_seen() -> None:
    """0.04 rad wide: the coarse look steps over it, the fine one does not."""

    def needle(rows: Array) -> Array:
        return np.where(np.abs(rows[:, :1] - 0.123) < 0.02, -0.01, 0.01)

    space = PlanningSpace(needle, [(0,)], np.zeros(1), np.zeros(1), np.ones(1))
    assert not is_clear(space, np.zeros(1), np.ones(1))
    assert is_clear(space, np.full(1, 0.2), np.ones(1))


@pytest.mark.parametrize("seed", range(6))
def test_no_stop_of_a_way_can_be_left_out_and_none_that_is_needed_is(seed: int) -> None:
    random = np.random.default_rng(seed)
    start, goal = (posture for posture in random.uniform(-0.6, 0.6, (2, 4)))
    start[:2], goal[:2] = (-0.3, 0.0), (0.3, 0.02 * seed)
    start[2:], goal[2:] = (0.3, 0.02 * seed), (-0.3, 0.0)
    found = plan_path(room(), start, goal)
    assert found is not None
    rows = [start, *found]
    assert len(rows) > 2
    assert all(is_clear(room(), a, b) for a, b in pairwise(rows))
    for k, stop in enumerate(rows):
        assert not any(is_clear(room(), stop, later) for later in rows[k + 2 :])


def test_a_contact_that_is_left_in_two_steps_is_left_in_one_line() -> None:
    """3 mm deep, and clear after two steps of 4 mm: they make one leg, and the rest of the way another."""
    touching, goal = np.array([-0.185, 0.0, 0.185, 0.0]), np.array([-0.6, 0.3, 0.6, -0.3])
    found = plan_path(room(), touching, goal)
    assert found is not None
    assert len(found) == 2
    np.testing.assert_allclose(found[0], [-0.225, 0.0, 0.225, 0.0], atol=1e-3)


def test_a_stop_at_a_corner_is_kept_and_one_on_a_straight_is_not() -> None:
    """Around the corner of a square, which is too big to be passed without a stop."""

    def corner(rows: Array) -> Array:
        return np.minimum(np.maximum(rows[:, :1], rows[:, 1:]) * 0.1 + 0.005, 0.01)

    space = PlanningSpace(corner, [(0, 1)], np.zeros(2), np.full(2, -1.0), np.ones(2))
    rows = [np.array(each) for each in ((0.0, -0.8), (0.0, -0.4), (0.0, 0.0), (-0.8, 0.0))]
    assert np.array(_shorten(space, rows)).tolist() == [[0.0, -0.8], [0.0, 0.0], [-0.8, 0.0]]
    assert np.array(_shorten(space, rows[1:])).tolist() == [[0.0, -0.4], [0.0, 0.0], [-0.8, 0.0]]
    assert np.array(_shorten(space, rows[:2])).tolist() == [[0.0, -0.8], [0.0, -0.4]]


def flat(*rows: tuple[float, float, float]) -> PlanningSpace:
    """Every pair's distance is a x + b y + c: its gradient is the same everywhere."""
    slopes, offsets = np.array([row[:2] for row in rows]), np.array([row[2] for row in rows])
    return PlanningSpace(lambda at: at @ slopes.T + offsets, [(0, 1)], np.zeros(2), np.full(2, -1.0), np.ones(2))


def test_out_of_contact_one_goes_up_the_slope_of_the_nearest_pair_in_steps_of_twenty_milliradians() -> None:
    """0.05 m a radian along x: from 1 mm deep 4 mm are four steps, the longest joint's part 0.02 rad."""
    rows = _back_out(flat((0.05, -0.025, -0.001)), np.zeros(2))
    assert rows is not None
    np.testing.assert_allclose(rows, [(0.02 * k, -0.01 * k) for k in range(5)], atol=1e-12)


def test_a_pair_that_is_half_a_millimetre_further_apart_counts_e_times_less_and_a_clear_one_nothing() -> None:
    nearest, further, clear_of = (0.1, 0.0, 0.0), (0.0, 0.1, 5e-4), (0.0, 5.0, 0.0041)
    rows = _back_out(flat(nearest, further, clear_of), np.zeros(2))
    assert rows is not None
    np.testing.assert_allclose(rows[1], [0.02, 0.02 / np.e], rtol=1e-9)


def test_what_cannot_come_apart_in_a_hundred_steps_or_has_no_slope_has_no_way_out() -> None:
    assert _back_out(flat((0.0, 0.0, 0.002)), np.zeros(2)) is None
    least = flat((0.0032 / 1.98, 0.0, 0.0))  # 3.2 mm in 99 steps, of which 3 are wanted.
    out = _back_out(least, np.full(2, -0.99))
    assert out is None, "it begins below nought"
    assert _back_out(flat((0.0032 / 1.98, 0.0, 0.0)), np.zeros(2)) is None, "the limit is in the way"
    ways = _back_out(flat((0.003 / 1.0, 0.0, 0.0)), np.zeros(2))
    assert ways is not None
    assert len(ways) == 51  # To the limit of 1 rad, where the pair is clear, and no further.
    assert ways[-1][0] == pytest.approx(1.0)


def test_a_line_is_looked_at_every_hundredth_of_a_radian_at_least() -> None:
    rows = postures_on_line(np.array([0.0, 0.1]), np.array([0.095, 0.05]))
    assert rows.shape == (11, 2)
    np.testing.assert_allclose(np.diff(rows, axis=0), np.tile([0.0095, -0.005], (10, 1)))
    np.testing.assert_array_equal(postures_on_line(np.ones(2), np.ones(2)), [[1.0, 1.0], [1.0, 1.0]])


def test_a_branch_is_three_tenths_of_a_radian_long_at_most_and_goes_on_from_the_nearest_posture() -> None:
    space = flat((0.0, 0.0, 0.01))
    tree = _Tree(np.zeros(2))
    assert tree.grow(space, np.zeros(2)) == (0, True)
    assert tree.grow(space, np.array([0.6, 0.3])) == (1, True)
    np.testing.assert_allclose(tree.postures[1], [0.3, 0.15])
    assert tree.grow(space, np.array([0.6, 0.3])) == (2, True)
    np.testing.assert_allclose(tree.postures[2], [0.6, 0.3])
    assert tree.grow(space, np.array([-0.1, 0.05])) == (3, True)
    np.testing.assert_allclose(tree.postures[3], [-0.1, 0.05])
    np.testing.assert_allclose(np.array(tree.path(2)), [[0.6, 0.3], [0.3, 0.15], [0.0, 0.0]])
    np.testing.assert_allclose(np.array(tree.path(3)), [[-0.1, 0.05], [0.0, 0.0]])


def test_a_branch_into_a_contact_is_none() -> None:
    tree = _Tree(np.zeros(2))
    assert tree.grow(flat((-0.1, 0.0, 0.01)), np.array([0.0701, 0.0])) == (0, False)
    assert tree.grow(flat((-0.1, 0.0, 0.01)), np.array([0.0699, 0.0])) == (1, True)


def test_a_goal_within_a_twentieth_of_a_radian_is_reached_without_leaving_a_contact() -> None:
    """The two lean on each other 1 mm deep, and slide."""
    leaning = np.array([-0.195, 0.0, 0.195, 0.0])
    near = leaning + np.array([0.0, 0.049, 0.0, 0.049])
    found = plan_path(room(), leaning, near)
    assert found is not None
    np.testing.assert_array_equal(found, [near])
    far = leaning + np.array([0.0, 0.051, 0.0, 0.051])
    further = plan_path(room(), leaning, far)
    assert further is not None
    assert len(further) > 1
