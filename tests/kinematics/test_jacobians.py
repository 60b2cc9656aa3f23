"""Jacobians and manipulability of the whole hand agree with what the fingertips do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.hand import HandKinematics, hand_kinematics
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.spec import SIDES, Side
from allegro_twin.types import Array

SPECS = {side: load_spec(side=side) for side in SIDES}
HANDS = {side: hand_kinematics(SPECS[side]) for side in SIDES}
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
    right, left = HANDS["right"].jacobian(q), HANDS["left"].jacobian(SPECS["right"].mirror_posture(q))
    mirror = np.diag([1.0, -1, 1, -1, 1, -1])  # A spin is a pseudovector.
    for name in right:
        np.testing.assert_allclose(left[name], SPECS["right"].mirror_posture(mirror @ right[name]), atol=1e-15)


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


ASKED: list[Callable[[HandKinematics, Any], Any]] = [
    HandKinematics.fingertips,
    HandKinematics.links,
    HandKinematics.jacobian,
    HandKinematics.manipulability,
    lambda hand, q: hand.fingertip_force(q, np.ones(16)),
    lambda hand, q: hand.fingertip_jacobians(q, ["index", "thumb"]),
    lambda hand, q: hand.gravity_torque(q, [0.0, 0.0, -9.81]),
]
NOT_POSTURES = [
    [0.1] * 15, [], 0.1, None, "index", ["a"] * 16, [[0.1, 0.2], [0.3]], {}, np.full(16, 1j), np.zeros((3, 16)),
    [*[0.1] * 15, float("nan")], [*[0.1] * 15, float("-inf")],
]  # fmt: skip


@pytest.mark.parametrize("asked", ASKED)
def test_a_list_is_as_good_as_an_array_and_what_is_no_posture_is_refused_in_one_line(
    asked: Callable[[HandKinematics, Any], Any],
) -> None:
    q = posture(3, "right")
    listed, given_ = asked(HANDS["right"], q.tolist()), asked(HANDS["right"], q)
    assert repr(listed) == repr(given_)
    for wrong in NOT_POSTURES:
        with pytest.raises(ConfigError, match=r"^[^\n]*(position|gravity_torque)[^\n]*$"):
            asked(HANDS["right"], wrong)


def test_what_else_the_hand_is_asked_with_is_refused_in_one_line() -> None:
    hand, q = HANDS["right"], posture(4, "right")
    wrong: list[tuple[str, Callable[[], Any]]] = [
        ("no finger named 'indx'; did you mean 'index'", lambda: hand.fingertip_jacobians(q, ["indx"])),
        ("torque_limit needs 16 numbers", lambda: hand.fingertip_force(q, [0.7] * 15)),
        ("torque_limit needs 16 numbers", lambda: hand.fingertip_force(q, [-0.7] * 16)),
        ("torque_limit must be numbers", lambda: hand.fingertip_force(q, "strong")),
        ("palm is no rotation matrix", lambda: hand.jacobian(q, 2.0 * np.eye(3))),
        ("palm, .* must be finite", lambda: hand.jacobian(q, np.full((3, 3), np.nan))),
        ("gravity_torque needs .* have .*2,", lambda: hand.gravity_torque(q, [0.0, 9.81])),
        ("gravity must be numbers, not 'down'", lambda: hand.gravity_torque(q, "down")),
        ("gravity must be finite", lambda: hand.gravity_torque(q, [0.0, 0.0, -np.inf])),
    ]
    for message, ask in wrong:
        with pytest.raises(ConfigError, match=f"^{message}") as refused:
            ask()
        assert "\n" not in str(refused.value)


def test_gravity_that_changes_in_place_is_felt_and_gravity_that_is_unknown_gives_no_torque() -> None:
    hand, q, gravity = hand_kinematics(SPECS["right"]), posture(5, "right"), np.array([0.0, 0.0, -9.81])
    upright = hand.gravity_torque(q, gravity)
    gravity[:] = [9.81, 0.0, 0.0]
    lying = hand.gravity_torque(q, gravity)
    np.testing.assert_array_equal(lying, hand_kinematics(SPECS["right"]).gravity_torque(q, [9.81, 0.0, 0.0]))
    assert np.abs(lying - upright).max() > 0.01
    assert np.isnan(hand.gravity_torque(q, np.full(3, np.nan))).any()
    np.testing.assert_array_equal(hand.gravity_torque([q, q], [gravity.tolist(), [0.0, 0.0, -9.81]]), [lying, upright])
    down = gravity.tolist()
    found = hand.gravity_torque([q, q, q, q], [down, down, [0.0, 0.0, -9.81], down])  # The last was another's.
    np.testing.assert_array_equal(found, [lying, lying, upright, lying])
    assert hand.gravity_torque(np.zeros((0, 16)), np.zeros((0, 3))).shape == (0, 16)


def test_a_file_that_is_not_the_hands_urdf_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "letter.urdf").write_text("Dear hand,")
    other = (tmp_path / "other.urdf", '<robot name="other"><link name="palm"/></robot>')
    other[0].write_text(other[1])
    for path, message in (
        (tmp_path / "letter.urdf", "is no URDF"),
        (other[0], "has no joint_0.0, joint_1.0, joint_2.0, ..."),
        (tmp_path / "none.urdf", "no URDF at"),
    ):
        with pytest.raises(ConfigError, match=message) as refused:
            HandKinematics(SPECS["right"], path)
        assert "\n" not in str(refused.value)
