"""What was shown comes out without the waiting, with few knots, and nowhere far from the record."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from allegro_twin.control.demonstration import TaughtMotion, trim_demonstration
from allegro_twin.errors import ConfigError
from allegro_twin.types import Array

KNOTS = arrays(float, (5, 4), elements=st.floats(-1, 1))


def record(knots: Array, waiting: int = 200) -> tuple[Array, Array]:
    """A motion through knots, 0.6 s apart, sampled every 3 ms, with waiting at both ends."""
    moving = np.concatenate([np.linspace(a, b, 200, endpoint=False) for a, b in pairwise(knots)])
    positions = np.concatenate([np.repeat(knots[:1], waiting, 0), moving, np.repeat(knots[-1:], waiting, 0)])
    return 0.003 * np.arange(float(len(positions))), positions


@given(KNOTS, st.floats(1e-3, 0.05))
@example(np.array([[0.02, 0.0, 0.0, 0.0], *np.zeros((4, 4))]), 0.03125)
def test_between_its_knots_it_leaves_the_record_by_no_more_than_the_tolerance(knots: Array, tolerance: float) -> None:
    times, positions = record(knots)
    if np.abs(positions - positions[0]).max() < 0.02:
        return
    motion = trim_demonstration(times, positions, tolerance=tolerance)
    path = motion.path()
    rows = np.array([path(t).position for t in 0.003 * np.arange(round(motion.times[-1] / 0.003) + 1)])
    windows = [positions[k : k + len(rows)] for k in range(len(positions) - len(rows) + 1)]
    assert min(np.abs(rows - window).max() for window in windows) <= tolerance + 1e-9


def test_a_motion_through_five_straight_knots_needs_five() -> None:
    knots = np.array([[0.0, 0.0], [0.5, 0.1], [0.2, 0.6], [0.9, 0.3], [0.0, 0.0]])
    times, positions = record(knots)
    motion = trim_demonstration(times, positions, tolerance=0.004)
    assert len(motion.times) <= 7
    assert motion.times[0] == 0.0
    assert motion.times[-1] == pytest.approx(2.4, abs=0.05)


@pytest.mark.parametrize("far", [0.011, 0.015, 0.02, -0.02, 0.021])
def test_a_motion_that_is_hardly_more_than_waiting_is_a_motion(far: float) -> None:
    times, positions = record(np.array([[far], [0.0]]))
    motion = trim_demonstration(times, positions)
    assert motion.seconds > 0.0
    assert motion.path().seconds == pytest.approx(motion.seconds)
    assert np.sign(motion.positions[-1, 0] - motion.positions[0, 0]) == -np.sign(far)


def test_nothing_taught_is_said() -> None:
    with pytest.raises(ConfigError, match=r"nothing was taught: no joint moved by more than 0\.01 rad"):
        trim_demonstration(0.003 * np.arange(10.0), np.zeros((10, 16)))


def test_it_plays_at_another_speed() -> None:
    times, positions = record(np.array([[0.0], [1.0]]))
    motion = trim_demonstration(times, positions)
    assert motion.path(2.0).seconds == pytest.approx(motion.times[-1] / 2)
    with pytest.raises(ConfigError, match="speed must be positive"):
        motion.path(0.0)


def test_a_motion_that_goes_nowhere_but_for_rounding_is_played() -> None:
    still = np.full((2, 16), 0.5)
    still[1, 0] += 1e-16
    assert still[1, 0] != 0.5
    path = TaughtMotion(np.array([0.0, 0.852]), still).path()  # No ConfigError.
    np.testing.assert_allclose(path(0.4).position, 0.5)
