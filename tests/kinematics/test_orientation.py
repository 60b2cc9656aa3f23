"""Euler angles, quaternions, matrices and rotation vectors say the same orientation, one or a batch of them."""

from __future__ import annotations

import inspect
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics import orientation
from allegro_twin.kinematics.maths import ARRAYS
from allegro_twin.types import Array

N = 5000
ANGLES = st.floats(-7.0, 7.0)
UNITS = arrays(np.float64, 4, elements=st.floats(-1.0, 1.0)).filter(lambda q: np.linalg.norm(q) > 1e-3)
VECTORS = arrays(np.float64, 3, elements=st.floats(-1.7, 1.7))


def random_rotations(seed: int) -> Array:
    return orientation.matrix_from_quaternion(np.random.default_rng(seed).normal(size=(N, 4)))


@settings(deadline=None)
@given(ANGLES, ANGLES, ANGLES)
def test_roll_pitch_and_yaw_mean_what_they_mean_in_urdf(roll: float, pitch: float, yaw: float) -> None:
    expected = pin.rpy.rpyToMatrix(roll, pitch, yaw)
    np.testing.assert_allclose(orientation.matrix_from_euler([roll, pitch, yaw]), expected, atol=1e-15)


def test_a_matrix_survives_the_way_through_euler_angles() -> None:
    rotations = random_rotations(1)
    angles = orientation.euler_from_matrix(rotations)
    assert np.abs(angles[:, 1]).max() <= np.pi / 2
    np.testing.assert_allclose(orientation.matrix_from_euler(angles), rotations, atol=1e-14)


def test_euler_angles_survive_the_way_through_a_matrix() -> None:
    angles = np.random.default_rng(2).uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (N, 3))
    np.testing.assert_allclose(orientation.euler_from_matrix(orientation.matrix_from_euler(angles)), angles, atol=1e-13)


@settings(deadline=None)
@given(ANGLES, st.sampled_from([-1.0, 1.0]), ANGLES, st.floats(-1e-7, 1e-7))
def test_in_gimbal_lock_the_angles_still_give_the_matrix_back(roll: float, up: float, yaw: float, off: float) -> None:
    turn = random_rotations(6)[0]  # There and back: the entries near zero then carry rounding, as measured ones do.
    rotation = turn @ (turn.T @ orientation.matrix_from_euler([roll, up * np.pi / 2 + off, yaw]))
    np.testing.assert_allclose(
        orientation.matrix_from_euler(orientation.euler_from_matrix(rotation)), rotation, atol=1e-14
    )


def test_a_matrix_survives_the_way_through_a_quaternion_even_at_half_a_turn() -> None:
    axes = np.vstack([np.random.default_rng(3).normal(size=(N, 3)), np.eye(3), -np.eye(3)])
    half_turns = orientation.matrix_from_quaternion(np.hstack([np.zeros((N + 6, 1)), axes]))
    for rotations in (random_rotations(4), half_turns):
        quaternions = orientation.quaternion_from_matrix(rotations)
        assert (quaternions[:, 0] >= 0).all()
        np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, atol=1e-15)
        np.testing.assert_allclose(orientation.matrix_from_quaternion(quaternions), rotations, atol=1e-14)


def test_a_quaternion_puts_the_real_part_first() -> None:
    quarter = orientation.matrix_from_quaternion([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    np.testing.assert_allclose(quarter @ [1, 0, 0], [0, 1, 0], atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 3.0, np.pi - 1e-9, np.pi])
def test_the_angle_between_orientations_is_exact_near_none_and_near_half_a_turn(angle: float) -> None:
    first = random_rotations(5)[0]
    second = first @ orientation.matrix_from_euler([0.0, 0.0, angle])
    assert orientation.angle_between(first, second) == pytest.approx(angle, abs=2e-8 if angle > 3.1 else 1e-14)


@pytest.mark.parametrize("bad", [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
def test_what_is_no_quaternion_is_refused(bad: list[float]) -> None:
    with pytest.raises(ConfigError, match="quaternion"):
        orientation.matrix_from_quaternion(bad)


def test_two_angles_are_no_euler_angles() -> None:
    with pytest.raises(ConfigError, match="roll, pitch, yaw"):
        orientation.matrix_from_euler([1.0, 2.0])


@settings(deadline=None)
@given(ANGLES, ANGLES, ANGLES)
def test_a_quaternion_from_euler_angles_is_that_of_their_matrix(roll: float, pitch: float, yaw: float) -> None:
    turn = orientation.matrix_from_quaternion(orientation.quaternion_from_euler([roll, pitch, yaw]))
    np.testing.assert_allclose(turn, orientation.matrix_from_euler([roll, pitch, yaw]), atol=1e-15)


@settings(deadline=None)
@given(VECTORS)
def test_a_rotation_vector_survives_the_way_through_a_quaternion(vector: Array) -> None:
    quaternion = orientation.quaternion_from_vector(vector)
    np.testing.assert_allclose(orientation.vector_from_quaternion(quaternion), vector, atol=1e-14)
    np.testing.assert_allclose(orientation.vector_from_quaternion(-quaternion), vector, atol=1e-14)
    np.testing.assert_allclose(orientation.matrix_from_quaternion(quaternion), pin.exp3(vector), atol=1e-15)


@settings(deadline=None)
@given(UNITS, UNITS)
def test_a_product_of_quaternions_turns_as_the_product_of_their_matrices(p: Array, q: Array) -> None:
    matrix = orientation.matrix_from_quaternion
    both = matrix(p) @ matrix(q)
    np.testing.assert_allclose(matrix(orientation.quaternion_product(p, q)), both, atol=1e-14)
    np.testing.assert_allclose(matrix(orientation.quaternion_conjugate(p)), matrix(p).T, atol=1e-15)


@settings(deadline=None)
@given(UNITS, UNITS)
def test_the_angle_between_quaternions_is_that_between_their_matrices(p: Array, q: Array) -> None:
    first, second = orientation.matrix_from_quaternion(p), orientation.matrix_from_quaternion(q)
    expected = orientation.angle_between(first, second)
    np.testing.assert_allclose(orientation.angle_between_quaternions(p, q), expected, atol=3e-8)


@settings(deadline=None)
@given(UNITS, UNITS, st.floats(0.0, 1.0))
def test_slerp_goes_the_shortest_way_at_constant_speed(p: Array, q: Array, part: float) -> None:
    between, whole = orientation.slerp(p, q, part), orientation.angle_between_quaternions(p, q)
    assert np.linalg.norm(between) == pytest.approx(1.0, abs=1e-14)
    assert orientation.angle_between_quaternions(p, between) == pytest.approx(part * whole, abs=1e-7)
    assert orientation.angle_between_quaternions(between, q) == pytest.approx((1 - part) * whole, abs=1e-7)


def test_slerp_ends_where_it_should() -> None:
    p, q = np.array([1.0, 0, 0, 0]), orientation.quaternion_from_vector([0.0, 0.0, 1.0])
    between = np.array([np.cos(0.125), 0, 0, np.sin(0.125)])
    np.testing.assert_allclose(orientation.slerp(p, q, [0.0, 0.25, 1.0]), np.stack([p, between, q]))


@settings(deadline=None)
@given(UNITS, VECTORS)
def test_a_turn_in_the_worlds_axes_comes_from_the_left(q: Array, vector: Array) -> None:
    turned = orientation.matrix_from_quaternion(orientation.rotate_quaternion(q, vector))
    np.testing.assert_allclose(turned, pin.exp3(vector) @ orientation.matrix_from_quaternion(q), atol=1e-14)


@settings(deadline=None)
@given(UNITS)
def test_gravity_in_the_palm_is_that_of_an_orientation_with_this_gravity(q: Array) -> None:
    gravity = orientation.gravity_from_quaternion(q)
    np.testing.assert_allclose(gravity, orientation.matrix_from_quaternion(q).T @ [0, 0, -9.81], atol=1e-14)
    again = orientation.gravity_from_quaternion(orientation.quaternion_from_gravity(gravity))
    np.testing.assert_allclose(again, gravity, atol=1e-13)


def test_a_palm_that_hangs_upside_down_has_an_orientation_too() -> None:
    np.testing.assert_array_equal(orientation.quaternion_from_gravity([0.0, 0.0, 9.81]), [0.0, 1.0, 0.0, 0.0])
    np.testing.assert_array_equal(orientation.quaternion_from_gravity([0.0, 0.0, -9.81]), [1.0, 0.0, 0.0, 0.0])


def test_a_palm_looks_where_it_is_told_to_with_its_fingers_as_near_as_can_be() -> None:
    turn = orientation.matrix_from_quaternion(orientation.quaternion_facing((0, 0, -1), (1, 0, 0.5)))
    np.testing.assert_allclose(turn[:, 0], [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(turn[:, 2], [1, 0, 0], atol=1e-15)
    with pytest.raises(ConfigError, match="must not be parallel"):
        orientation.matrix_facing((0, 0, 1), (0, 0, -2))


def test_one_orientation_and_a_batch_of_them_give_the_same_bits() -> None:
    rng = np.random.default_rng(7)
    q, p, v, part = rng.normal(size=(40, 4)), rng.normal(size=(40, 4)), rng.normal(size=(40, 3)), rng.random(40)
    r = orientation.matrix_from_quaternion(q)
    calls: list[tuple[Callable[..., Array], tuple[Array, ...]]] = [
        (orientation.matrix_from_quaternion, (q,)), (orientation.quaternion_from_matrix, (r,)),
        (orientation.matrix_from_euler, (v,)), (orientation.euler_from_matrix, (r,)),
        (orientation.quaternion_from_euler, (v,)), (orientation.quaternion_from_vector, (v,)),
        (orientation.vector_from_quaternion, (q,)), (orientation.quaternion_product, (p, q)),
        (orientation.rotate_quaternion, (q, v)), (orientation.slerp, (p, q, part)),
        (orientation.angle_between, (r, r[::-1])), (orientation.angle_between_quaternions, (p, q)),
        (orientation.gravity_from_quaternion, (q,)), (orientation.quaternion_from_gravity, (v,)),
        (orientation.quaternion_facing, (v, p[:, :3])), (orientation.quaternion_conjugate, (q,)),
    ]  # fmt: skip
    for call, arguments in calls:
        batch = call(*arguments)
        grid = call(*(a.reshape(8, 5, *a.shape[1:]) for a in arguments))
        np.testing.assert_array_equal(grid.reshape(batch.shape), batch, err_msg=call.__name__)
        for row in range(40):
            one = call(*(a[row] for a in arguments))
            # An arc tangent of many at a time may end in another digit than one of a few.
            np.testing.assert_allclose(one, batch[row], rtol=0, atol=2e-15, err_msg=call.__name__)


def test_the_home_of_orientations_needs_numpy_alone() -> None:
    code = "import sys, allegro_twin.kinematics.orientation; print(*{name.split('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"mujoco", "pinocchio", "scipy", "yaml"} & set(done.stdout.split())


@pytest.mark.parametrize(("longer", "turned", "is_one"), [
    (5e-6, 0.0, True), (6e-6, 0.0, False), (0.0, 0.9e-6, True), (0.0, 1.1e-6, False)
])  # fmt: skip
def test_a_rotation_is_one_to_as_much_as_it_says(longer: float, turned: float, is_one: bool) -> None:
    matrix = np.eye(3)
    matrix[:, 0] = 1.0 + longer, turned, 0.0
    assert orientation.is_rotation(ARRAYS, orientation.entries_of_matrix(matrix)) is is_one


def test_the_functions_that_take_tensors_are_those_that_say_so() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed: pip install 'allegro-twin[warp]'")
    q, v = torch.tensor([[1.0, 0.0, 0.0, 0.0]]), torch.tensor([[0.1, 0.2, 0.3]])
    calls: dict[Any, tuple[Any, ...]] = {
        orientation.quaternion_from_vector: (v,), orientation.quaternion_product: (q, q),
        orientation.rotate_quaternion: (q, v), orientation.angle_between_quaternions: (q, q),
    }  # fmt: skip
    public = [each for name, each in vars(orientation).items() if inspect.isfunction(each) and name[0] != "_"]
    assert {each for each in public if "Takes tensors, too" in " ".join(str(each.__doc__).split())} == set(calls)
    assert all(isinstance(call(*values), torch.Tensor) for call, values in calls.items())
