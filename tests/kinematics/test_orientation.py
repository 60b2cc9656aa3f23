"""Euler angles, quaternions and matrices say the same orientation."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics import orientation as euler
from allegro_twin.types import Array

N = 5000
ANGLES = st.floats(-7.0, 7.0)


def random_rotations(seed: int) -> Array:
    return euler.matrix_from_quaternion(np.random.default_rng(seed).normal(size=(N, 4)))


@given(ANGLES, ANGLES, ANGLES)
def test_roll_pitch_and_yaw_mean_what_they_mean_in_urdf(roll: float, pitch: float, yaw: float) -> None:
    expected = pin.rpy.rpyToMatrix(roll, pitch, yaw)
    np.testing.assert_allclose(euler.matrix_from_euler([roll, pitch, yaw]), expected, atol=1e-15)


def test_a_matrix_survives_the_way_through_euler_angles() -> None:
    rotations = random_rotations(1)
    angles = euler.euler_from_matrix(rotations)
    assert np.abs(angles[:, 1]).max() <= np.pi / 2
    np.testing.assert_allclose(euler.matrix_from_euler(angles), rotations, atol=1e-14)


def test_euler_angles_survive_the_way_through_a_matrix() -> None:
    angles = np.random.default_rng(2).uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (N, 3))
    np.testing.assert_allclose(euler.euler_from_matrix(euler.matrix_from_euler(angles)), angles, atol=1e-13)


@given(ANGLES, st.sampled_from([-1.0, 1.0]), ANGLES, st.floats(-1e-7, 1e-7))
def test_in_gimbal_lock_the_angles_still_give_the_matrix_back(roll: float, up: float, yaw: float, off: float) -> None:
    turn = random_rotations(6)[0]  # There and back: the entries near zero then carry rounding, as measured ones do.
    rotation = turn @ (turn.T @ euler.matrix_from_euler([roll, up * np.pi / 2 + off, yaw]))
    np.testing.assert_allclose(euler.matrix_from_euler(euler.euler_from_matrix(rotation)), rotation, atol=1e-14)


def test_a_matrix_survives_the_way_through_a_quaternion_even_at_half_a_turn() -> None:
    axes = np.vstack([np.random.default_rng(3).normal(size=(N, 3)), np.eye(3), -np.eye(3)])
    half_turns = euler.matrix_from_quaternion(np.hstack([np.zeros((N + 6, 1)), axes]))
    for rotations in (random_rotations(4), half_turns):
        quaternions = euler.quaternion_from_matrix(rotations)
        assert (quaternions[:, 0] >= 0).all()
        np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, atol=1e-15)
        np.testing.assert_allclose(euler.matrix_from_quaternion(quaternions), rotations, atol=1e-14)


def test_a_quaternion_puts_the_real_part_first() -> None:
    quarter = euler.matrix_from_quaternion([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    np.testing.assert_allclose(quarter @ [1, 0, 0], [0, 1, 0], atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 3.0, np.pi - 1e-9, np.pi])
def test_the_angle_between_orientations_is_exact_near_none_and_near_half_a_turn(angle: float) -> None:
    first = random_rotations(5)[0]
    second = first @ euler.matrix_from_euler([0.0, 0.0, angle])
    assert euler.angle_between(first, second) == pytest.approx(angle, abs=2e-8 if angle > 3.1 else 1e-14)


@pytest.mark.parametrize("bad", [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
def test_what_is_no_quaternion_is_refused(bad: list[float]) -> None:
    with pytest.raises(ConfigError, match="quaternion"):
        euler.matrix_from_quaternion(bad)


def test_two_angles_are_no_euler_angles() -> None:
    with pytest.raises(ConfigError, match="roll, pitch, yaw"):
        euler.matrix_from_euler([1.0, 2.0])
