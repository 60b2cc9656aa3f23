"""Jacobians and manipulability of the whole hand agree with what the fingertips do."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allegro_twin.description.hands import load_spec
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.model import HandModel
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.spec import SIDES, Side
from allegro_twin.types import Array

SPECS = {side: load_spec(side=side) for side in SIDES}
HANDS = {side: HandModel(SPECS[side]) for side in SIDES}
SEEDS = st.integers(0, 2**32 - 1)
STEP = 1e-6


def posture(seed: int, side: Side) -> Array:
    return np.random.default_rng(seed).uniform(SPECS[side].lower, SPECS[side].upper)


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.sampled_from(SIDES))
def test_the_jacobian_is_the_derivative_of_the_fingertip_pose(seed: int, side: Side) -> None:
    """Central differences err by STEP² / 6 of the third derivative and rounding over STEP, both below 1e-9."""
    hand, q = HANDS[side], posture(seed, side)
    jacobian, here = hand.jacobian(q), hand.fingertips(q)
    for joint in range(16):
        step = np.zeros(16)
        step[joint] = STEP
        after, before = hand.fingertips(q + step), hand.fingertips(q - step)
        for name, pose in here.items():
            velocity = (after[name].position - before[name].position) / (2 * STEP)
            spin = (after[name].rotation - before[name].rotation) / (2 * STEP) @ pose.rotation.T
            np.testing.assert_allclose(jacobian[name][:3, joint], velocity, atol=1e-9)
            np.testing.assert_allclose(jacobian[name][3:, joint], [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-8)


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.sampled_from(SIDES))
def test_a_turned_palm_turns_the_jacobian_into_the_world(seed: int, side: Side) -> None:
    q, palm = posture(seed, side), matrix_from_quaternion(np.random.default_rng(seed).normal(size=4))
    local, world = HANDS[side].jacobian(q), HANDS[side].jacobian(q, palm)
    for name in local:
        np.testing.assert_allclose(world[name][:3], palm @ local[name][:3], atol=1e-15)
        np.testing.assert_allclose(world[name][3:], palm @ local[name][3:], atol=1e-15)


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_the_left_jacobian_is_the_mirrored_right_one(seed: int) -> None:
    q = posture(seed, "right")
    right, left = HANDS["right"].jacobian(q), HANDS["left"].jacobian(SPECS["right"].mirrored(q))
    mirror = np.diag([1.0, -1, 1, -1, 1, -1])  # A spin is a pseudovector.
    for name in right:
        np.testing.assert_allclose(left[name], SPECS["right"].mirrored(mirror @ right[name]), atol=1e-15)


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.sampled_from(SIDES))
def test_manipulability_is_the_volume_that_unit_joint_speeds_span(seed: int, side: Side) -> None:
    q = posture(seed, side)
    jacobian = HANDS[side].jacobian(q)
    for name, value in HANDS[side].manipulability(q).items():
        linear = jacobian[name][:3]
        assert value == pytest.approx(np.sqrt(max(0.0, np.linalg.det(linear @ linear.T))), rel=1e-6, abs=1e-12)


def test_a_straight_finger_cannot_move_along_itself_and_a_bent_one_can() -> None:
    straight = np.clip(np.zeros(16), SPECS["right"].lower, SPECS["right"].upper)
    bent = straight + np.tile([0.0, 0.5, 0.5, 0.5], 4)
    assert HANDS["right"].manipulability(straight)["middle"] < 1e-9
    assert HANDS["right"].manipulability(bent)["middle"] > 1e-5


def test_a_palm_that_is_no_matrix_is_refused() -> None:
    with pytest.raises(ConfigError, match="shape \\(3, 3\\)"):
        HANDS["right"].jacobian(np.zeros(16), np.array([1.0, 0, 0, 0]))


def test_gravity_of_a_list_is_that_of_an_array_and_a_wrong_shape_is_one_line_of_ours() -> None:
    model, q, down = HandModel(load_spec()), [0.1] * 16, [0.0, 0.0, -9.81]
    listed = model.gravity_torque(q, down)  # type: ignore[arg-type]
    np.testing.assert_array_equal(listed, model.gravity_torque(np.array(q), np.array(down)))
    for wrong, pull in ((q[:15], down), (q, down[:2]), ([q, q], down), (["a"] * 16, down)):
        with pytest.raises(ConfigError, match=r"gravity_torque needs .*16"):
            model.gravity_torque(wrong, pull)  # type: ignore[arg-type]
