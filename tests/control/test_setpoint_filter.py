"""A goal that moves is followed without a jump of position, speed or acceleration."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from allegro_twin.control.setpoint_filter import SmoothSetpoint
from allegro_twin.types import Array

Q = arrays(float, 3, elements=st.floats(-1.5, 1.5))


def test_it_rests_where_it_is_until_it_heads_for_a_goal_and_is_there_when_it_says() -> None:
    steering = SmoothSetpoint(np.zeros(2))
    np.testing.assert_array_equal(steering(5.0).position, [0.0, 0.0])
    end = steering.head_for(5.0, np.array([1.0, -0.5]), 2.0)
    assert end == 5.0 + 15.0 / 8.0 / 2.0
    np.testing.assert_allclose(steering(end).position, [1.0, -0.5], atol=1e-12)
    np.testing.assert_allclose(steering(end + 9.0).velocity, 0.0, atol=1e-12)


def test_from_rest_the_joint_that_travels_furthest_peaks_at_the_speed() -> None:
    steering = SmoothSetpoint(np.zeros(2))
    end = steering.head_for(0.0, np.array([1.2, 0.3]), 2.0)
    speeds = np.array([steering(t).velocity for t in np.linspace(0.0, end, 2001)])
    assert abs(np.abs(speeds).max() - 2.0) < 1e-3


@given(Q, Q, st.floats(0.2, 5.0), st.floats(0.5, 30.0))
def test_from_rest_neither_speed_nor_acceleration_is_exceeded_however_short_the_way(
    begin: Array, goal: Array, speed: float, acceleration: float
) -> None:
    steering = SmoothSetpoint(begin)
    end = steering.head_for(0.0, goal, speed, acceleration)
    legs = [steering._leg.at(t) for t in np.linspace(0.0, end, 400)]
    assert max(np.abs(leg[1]).max() for leg in legs) <= speed * (1.0 + 1e-6)
    assert max(np.abs(leg[2]).max() for leg in legs) <= acceleration * (1.0 + 1e-6)


@given(Q, Q, Q, st.floats(0.01, 1.0))
def test_another_goal_on_the_way_makes_no_jump(begin: Array, first: Array, second: Array, part: float) -> None:
    steering = SmoothSetpoint(begin)
    turn = part * steering.head_for(0.0, first, 3.0)
    before = steering(turn), steering._leg.at(turn)[2]
    steering.head_for(turn, second, 3.0)
    after = steering(turn), steering._leg.at(turn)[2]
    for old, new in zip((*before[0], before[1]), (*after[0], after[1]), strict=True):
        np.testing.assert_allclose(new, old, atol=1e-9)


def test_a_goal_that_moves_twenty_times_a_second_is_kept_up_with() -> None:
    steering, t = SmoothSetpoint(np.zeros(1)), 0.0
    for k in range(40):
        t = 0.05 * k
        steering.head_for(t, np.array([0.5 * t]), 3.0)
    assert abs(steering(t).position[0] - 0.5 * t) < 0.5 * 0.15  # No further behind than its shortest time.
