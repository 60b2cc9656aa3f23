"""All joints arrive together, at the speed that was asked for."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from allegro_twin.control.trajectory import Hold, Moves, Profile, Waypoint
from allegro_twin.errors import ConfigError
from allegro_twin.types import Array

POSTURE = arrays(float, 16, elements=st.floats(-1.5, 1.5))
PROFILES: list[Profile] = ["linear", "minimum_jerk", "time_optimal"]


@given(POSTURE, POSTURE, st.floats(0.1, 5.0), st.sampled_from(PROFILES))
def test_the_joint_that_travels_furthest_peaks_at_the_speed(
    start: Array, goal: Array, speed: float, profile: Profile
) -> None:
    if np.abs(goal - start).max() < 0.01:
        return
    path = Moves([Waypoint(goal, speed=speed, profile=profile, acceleration=1e5)]).begin(start)
    velocities = np.array([path(t).velocity for t in np.linspace(0, path.seconds * 0.999, 401)])
    assert np.abs(velocities).max() == pytest.approx(speed, rel=1e-3)


@given(POSTURE, POSTURE, st.sampled_from(PROFILES))
def test_all_joints_leave_together_and_arrive_together(start: Array, goal: Array, profile: Profile) -> None:
    path = Moves([Waypoint(goal, profile=profile)]).begin(start)
    np.testing.assert_allclose(path(0.0).position, start, atol=1e-12)
    np.testing.assert_array_equal(path(path.seconds).position, goal)
    travel = goal - start
    middle = path(path.seconds * 0.3).position - start
    moving = np.abs(travel) > 1e-6
    parts = middle[moving] / travel[moving]
    assert parts.size == 0 or np.ptp(parts) < 1e-9


@given(POSTURE, POSTURE, POSTURE)
def test_a_trajectory_goes_through_its_waypoints_without_a_jump(start: Array, middle: Array, goal: Array) -> None:
    path = Moves([Waypoint(middle, seconds=0.5), Waypoint(goal, seconds=0.7)]).begin(start)
    np.testing.assert_allclose(path(0.5).position, middle, atol=1e-9)
    times = np.linspace(0, 1.4, 1401)
    positions = np.array([path(t).position for t in times])
    assert np.abs(np.diff(positions, axis=0)).max() <= 1e-3 * 3.0 * 15 / 8 / 0.5 + 1e-9
    np.testing.assert_array_equal(path(99.0).velocity, np.zeros(16))


def test_velocity_is_the_derivative_of_position() -> None:
    path = Moves([Waypoint(np.array([1.0, -0.5]), seconds=1.0)]).begin(np.zeros(2))
    for t in np.linspace(0.05, 0.95, 19):
        numeric = (path(t + 1e-6).position - path(t - 1e-6).position) / 2e-6
        np.testing.assert_allclose(path(t).velocity, numeric, atol=1e-6)


def test_holding_is_being_there_at_once() -> None:
    point = Hold(np.array([0.1, 0.2])).begin(np.zeros(2))(0.0)
    np.testing.assert_array_equal(point.position, [0.1, 0.2])
    np.testing.assert_array_equal(point.velocity, [0.0, 0.0])


@given(POSTURE, POSTURE, st.floats(0.1, 6.0), st.floats(0.5, 100.0))
def test_a_time_optimal_move_keeps_both_limits_and_uses_one_of_them_at_any_time(
    start: Array, goal: Array, speed: float, acceleration: float
) -> None:
    furthest = np.abs(goal - start).max()
    if furthest < 0.01:
        return
    path = Moves([Waypoint(goal, speed=speed, profile="time_optimal", acceleration=acceleration)]).begin(start)
    dt = path.seconds / 1000
    velocity = np.array([path(k * dt).velocity for k in range(1001)])
    change = np.diff(velocity, axis=0) / dt
    assert np.abs(velocity).max() <= speed * (1 + 1e-9)
    assert np.abs(change).max() <= acceleration * (1 + 1e-6)
    # The shortest time: half of the way to gain speed and half to lose it, or with the greatest speed in between.
    ramp = speed**2 / acceleration
    shortest = furthest / speed + speed / acceleration if furthest > ramp else 2 * np.sqrt(furthest / acceleration)
    assert path.seconds == pytest.approx(shortest, rel=1e-6)
    np.testing.assert_array_equal(path(path.seconds).position, goal)
    np.testing.assert_array_equal(path(path.seconds).velocity, np.zeros(16))
    np.testing.assert_allclose(path(path.seconds - 1e-9).position, goal, atol=1e-7)


def test_a_time_that_is_asked_for_stretches_a_time_optimal_move() -> None:
    move = Waypoint(np.array([1.0, -0.5]), speed=2.0, profile="time_optimal", acceleration=8.0)
    fast, slow = Moves([move]).begin(np.zeros(2)), Moves([replace(move, seconds=3.0)]).begin(np.zeros(2))
    assert fast.seconds == pytest.approx(0.75)
    assert slow.seconds == 3.0
    for s in np.linspace(0.0, 0.99, 12):
        np.testing.assert_allclose(slow(s * 3.0).position, fast(s * 0.75).position, atol=1e-9)
        np.testing.assert_allclose(slow(s * 3.0).velocity, fast(s * 0.75).velocity / 4.0, atol=1e-9)


def test_a_time_optimal_move_without_ruckig_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ruckig", None)
    with pytest.raises(ConfigError, match=r"pip install 'allegro-twin\[trajectory\]'"):
        Moves([Waypoint(np.ones(2), profile="time_optimal")]).begin(np.zeros(2))
    assert Moves([Waypoint(np.ones(2))]).begin(np.zeros(2)).seconds == pytest.approx(15 / 8)


@pytest.mark.parametrize(
    "waypoint",
    [Waypoint(np.ones(2), acceleration=0.0), Waypoint(np.ones(2), speed=0.0), Waypoint(np.ones(2), seconds=-1.0)],
)
def test_a_speed_an_acceleration_or_a_time_must_be_positive(waypoint: Waypoint) -> None:
    with pytest.raises(ConfigError, match="positive"):
        Moves([waypoint]).begin(np.zeros(2))
