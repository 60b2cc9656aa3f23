"""What is left to a goal, for every learner and in the file."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.kinematics.orientation import quaternion_from_vector, rotate_quaternion
from allegro_twin.learning.training.goal_features import goal_difference, goal_difference_width


def turns(count: int, size: float) -> np.ndarray:
    return np.random.default_rng(3).uniform(-size, size, (count, 3))


@pytest.mark.parametrize("flipped", [1.0, -1.0])
def test_the_turn_that_is_left_is_about_its_axis_and_twice_the_sine_of_half_of_it(flipped: float) -> None:
    here = quaternion_from_vector(turns(20, 2.0))
    vector = turns(20, 1.0)
    goal = flipped * rotate_quaternion(here, vector)
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    expected = vector / angle * 2.0 * np.sin(angle / 2.0)
    np.testing.assert_allclose(goal_difference(goal, here, True), expected, atol=1e-6)
    assert goal_difference_width(4, True) == 3


def test_of_positions_it_is_the_difference() -> None:
    goal, here = np.ones((2, 12)), np.full((2, 12), 0.25)
    np.testing.assert_array_equal(goal_difference(goal, here, False), np.full((2, 12), 0.75))
    assert goal_difference_width(12, False) == 12
