"""What a search along a curve of postures is made of, each against the same by counting."""

from __future__ import annotations

from itertools import pairwise
from math import acos, cos, pi, sin

import numpy as np
import pytest

from allegro_twin.kinematics.closed_form.redundancy.curve import CurveParameter, PostureRates, Segment, near_turn
from allegro_twin.kinematics.closed_form.redundancy.preferences import _clearance, _least_clearance, _rate, _turns_back
from allegro_twin.kinematics.closed_form.redundancy.thumb import (
    _POINT,
    Interval,
    _clamped_acos,
    _common,
    _inside_range_of_q0,
)

DRAW = np.random.default_rng(3)
TAUS = np.linspace(-pi + 1e-3, 2 * pi - 1e-3, 997)


def covered(intervals: list[Interval], tau: float, by: float = 0.0) -> bool:
    return any(low - by <= tau <= high + by for low, high in intervals)


@pytest.mark.parametrize("number", range(60))
def test_where_a_joint_that_goes_to_and_fro_is_inside_a_range(number: int) -> None:
    """q₀ = middle - half · cos τ, or a full turn beside that."""
    middle, half = DRAW.uniform(-4.0, 4.0), (0.3, 1.0, 2.5)[number % 3]
    low = DRAW.uniform(-3.0, 2.0)
    high = low + DRAW.uniform(0.1, 3.0)
    found = _inside_range_of_q0(CurveParameter(middle, half, 1.0), (low, high))
    for tau in TAUS:
        angle = middle - half * cos(tau)
        off = min(abs(angle + turn - end) for end in (low, high) for turn in (0.0, 2 * pi, -2 * pi))
        if off > 2e-3:
            inside = any(low <= angle + turn <= high for turn in (0.0, 2 * pi, -2 * pi))
            assert covered(found, float(tau)) == inside, (middle, half, low, high, tau)


@pytest.mark.parametrize("only", [(-0.3, 0.4), (-9.0, 9.0)])
def test_a_joint_that_never_leaves_a_range_is_in_it_everywhere_and_one_that_never_enters_nowhere(
    only: Interval,
) -> None:
    if only[1] < 1.0:
        assert _inside_range_of_q0(CurveParameter(2.0, 0.5, 1.0), only) == []
        assert _inside_range_of_q0(CurveParameter(0.0, 0.25, 1.0), only) == [(-pi, 2 * pi)]
    else:
        assert (-pi, 2 * pi) in _inside_range_of_q0(CurveParameter(0.0, 1.0, 1.0), only)


def test_where_the_angle_is_tau_itself_the_range_is_its_own_and_a_turn_to_either_side() -> None:
    assert _inside_range_of_q0(CurveParameter(0.7, 0.0, -1.0), (-0.5, 1.0)) == [
        (-0.5, 1.0), (-0.5 + 2 * pi, 1.0 + 2 * pi), (-0.5 - 2 * pi, 1.0 - 2 * pi),
    ]  # fmt: skip


def test_what_is_common_to_two_sets_of_ranges_is_in_both() -> None:
    for _ in range(60):
        first, second = ([tuple(sorted(DRAW.uniform(-3.0, 3.0, 2))) for _ in range(3)] for _ in range(2))
        found = _common(first, second)
        for tau in np.linspace(-3.0, 3.0, 301):
            both = covered(first, float(tau)) and covered(second, float(tau))
            assert covered(found, float(tau)) == both


def test_ranges_that_touch_or_all_but_touch_have_a_point_in_common() -> None:
    assert _common([(0.0, 1.0)], [(1.0, 2.0)]) == [(1.0, 1.0)]
    assert _common([(0.0, 1.0)], [(1.0 + 0.5 * _POINT, 2.0)]) == [(1.0, 1.0 + 0.5 * _POINT)]
    assert _common([(1.0 + 0.5 * _POINT, 2.0)], [(0.0, 1.0)]) == [(1.0, 1.0 + 0.5 * _POINT)]
    assert _common([(0.0, 1.0)], [(1.0 + 1.5 * _POINT, 2.0)]) == []


def test_an_arc_cosine_beyond_its_ends_is_the_end() -> None:
    assert [_clamped_acos(along, 2.0) for along in (2.0, 3.0, -2.0, -2.1, 0.0)] == [0.0, 0.0, pi, pi, pi / 2]
    assert _clamped_acos(1.0, 2.0) == acos(0.5)


def test_an_angle_is_brought_within_half_a_turn_of_another() -> None:
    for middle in (-2.0, 0.0, 1.5):
        for angle in np.linspace(middle - 2.9 * pi, middle + 2.9 * pi, 59):
            near = near_turn(float(angle), middle)
            assert abs(near - middle) <= pi + 1e-12
            assert (near - angle) / (2 * pi) == pytest.approx(round((near - angle) / (2 * pi)), abs=1e-12)
        assert near_turn(middle + pi, middle) == middle + pi
        assert near_turn(middle - pi, middle) == middle - pi


def test_tau_is_found_again_from_the_angle_and_the_side_of_the_elbow() -> None:
    course = CurveParameter(0.4, 1.3, 1.0)
    for tau in np.linspace(-3.1, 3.1, 63):
        angle = course.middle - course.half * cos(tau)
        for turn in (0.0, 2 * pi, -2 * pi):
            assert course.tau(angle + turn, sin(tau)) == pytest.approx(tau, abs=1e-7)
    assert course.tau(course.middle - 1.31, 1.0) == 0.0
    assert course.tau(course.middle + 1.31, -1.0) == -pi
    assert CurveParameter(0.4, 0.0, -1.0).tau(0.3 + 2 * pi, -1.0) == pytest.approx(0.3)


def at(tau: float) -> PostureRates:
    return (tau, 2 * tau, 3 * tau, 4 * tau, 1.0, 2.0, 3.0, 4.0)


@pytest.mark.parametrize(
    ("low", "high", "step", "count"), [(0.0, 1.0, 0.5, 3), (0.0, 1.0, 0.49, 5), (-1.0, 1.0, 0.7, 5), (0.0, 3.0, 0.5, 7)]
)
def test_knots_are_even_no_further_apart_than_a_step_and_have_the_middle_that_is_known(
    low: float, high: float, step: float, count: int
) -> None:
    asked: list[float] = []

    def way(tau: float) -> PostureRates:
        asked.append(tau)
        return at(tau)

    middle = (low + high) / 2
    found = Segment(way, low, high, at(middle)).knots(step)
    assert len(found) == count
    assert [tau for tau, _ in found] == pytest.approx(list(np.linspace(low, high, count)))
    assert all(posture == at(tau) for tau, posture in found)
    assert middle not in asked, "it has been computed already"
    assert max(b[0] - a[0] for a, b in pairwise(found)) <= step + 1e-12


def test_what_is_tight_is_the_least_of_eight_rooms_with_its_rate() -> None:
    for _ in range(400):
        lower = DRAW.uniform(-1.0, -0.5, 4)
        upper = DRAW.uniform(0.5, 1.0, 4)
        q, rates = DRAW.uniform(lower, upper), DRAW.uniform(-1.0, 1.0, 4)
        moving: PostureRates = (*q.tolist(), *rates.tolist())
        limits = tuple(np.stack([lower, upper], axis=1).reshape(-1).tolist())
        rooms = np.concatenate([q - lower, upper - q])
        which = int(rooms.argmin())
        room, rate, found = _least_clearance(moving, limits)  # type: ignore[arg-type]  # Likewise.
        assert found == which
        assert room == pytest.approx(rooms[which])
        assert rate == (rates[which] if which < 4 else -rates[which - 4])
        for each in range(8):
            assert _clearance(moving, each, limits) == pytest.approx(rooms[each])  # type: ignore[arg-type]  # Likewise.
            assert _rate(moving, each) == (rates[each] if each < 4 else -rates[each - 4])


def test_a_joint_turns_back_where_its_rate_changes_its_sign() -> None:
    still = (0.0,) * 4
    for joint in range(4):
        rates = [1.0] * 4
        rates[joint] = -1.0
        assert _turns_back((*still, 1.0, 1.0, 1.0, 1.0), (*still, *rates))  # type: ignore[arg-type]  # Likewise.
    assert not _turns_back((*still, 1.0, -1.0, 1.0, 0.0), (*still, 2.0, -1.0, 3.0, -1.0))
