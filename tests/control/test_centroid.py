"""The centroid grasp presses without pushing, resists what moves the object, and notices contact."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from allegro_twin.control.force_grasp import (
    StallTimes,
    fingers_in_contact,
    holding_forces,
    joint_torques,
    null_space_torque,
    pressing_forces,
    update_stall,
)
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.types import Array

SPEC = load_spec()
MODEL = hand_kinematics(SPEC)
TIPS = st.integers(2, 4).flatmap(lambda k: arrays(float, (k, 3), elements=st.floats(-0.1, 0.1)))


@given(TIPS, st.floats(0.1, 10.0), st.floats(0.0, 1.0))
def test_the_pressing_forces_neither_push_nor_turn_the_object(tips: Array, force: float, spread: float) -> None:
    forces = pressing_forces(tips, force, spread)
    np.testing.assert_allclose(forces.sum(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.cross(tips, forces).sum(axis=0), 0.0, atol=1e-9)


@given(TIPS, st.floats(0.1, 10.0))
def test_the_thumb_presses_with_the_force_that_was_asked_for(tips: Array, force: float) -> None:
    if np.linalg.norm(tips[-1] - tips[:-1].mean(axis=0)) > 1e-3:
        assert abs(np.linalg.norm(pressing_forces(tips, force)[-1]) - force) < 1e-9


def test_two_fingertips_press_along_the_line_between_them() -> None:
    forces = pressing_forces(np.array([[0.0, 0.0, 0.03], [0.0, 0.0, -0.03]]), 2.0)
    np.testing.assert_allclose(forces, [[0, 0, -2.0], [0, 0, 2.0]], atol=1e-12)


@given(arrays(float, (3, 3), elements=st.floats(-0.1, 0.1)), arrays(float, 3, elements=st.floats(-0.01, 0.01)))
def test_a_shifted_object_is_brought_back(tips: Array, shift: Array) -> None:
    forces = holding_forces(tips, tips - shift, 600.0)
    np.testing.assert_allclose(forces, np.broadcast_to(-600.0 * shift, (3, 3)), atol=1e-9)


def test_opening_and_closing_is_left_to_the_pressing() -> None:
    spots = np.array([[0.0, 0.0, 0.03], [0.0, 0.0, -0.03]])
    np.testing.assert_allclose(holding_forces(spots * 1.1, spots, 600.0), 0.0, atol=1e-12)


def test_a_batch_is_the_same_as_one_after_the_other() -> None:
    rng = np.random.default_rng(0)
    tips, spots = rng.normal(size=(2, 5, 4, 3)) * 0.05
    for k in range(5):
        np.testing.assert_allclose(pressing_forces(tips, np.full(5, 2.0))[k], pressing_forces(tips[k], 2.0))
        np.testing.assert_allclose(holding_forces(tips, spots, 300.0)[k], holding_forces(tips[k], spots[k], 300.0))


@given(st.integers(0, 2**32 - 1))
def test_the_work_of_joint_torques_is_the_work_of_the_forces(seed: int) -> None:
    rng = np.random.default_rng(seed)
    position = rng.uniform(SPEC.lower, SPEC.upper)
    fingers = ("index", "ring", "thumb")
    tips, jacobians = MODEL.fingertip_jacobians(position, fingers)
    forces, step = rng.normal(size=(3, 3)), 1e-7 * rng.normal(size=16)
    moved, _ = MODEL.fingertip_jacobians(position + step, fingers)
    np.testing.assert_allclose(joint_torques(jacobians, forces) @ step, (forces * (moved - tips)).sum(), atol=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_a_posture_torque_is_not_felt_at_the_fingertips(seed: int) -> None:
    """What is left of it accelerates no fingertip of a hand whose joints are alike: J τ = 0."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(SPEC.lower + 0.3 * (SPEC.upper - SPEC.lower), SPEC.upper - 0.2 * (SPEC.upper - SPEC.lower))
    _, jacobians = MODEL.fingertip_jacobians(position, ("index", "middle", "ring", "thumb"))
    torque = rng.normal(size=16)
    left = null_space_torque(jacobians, torque, damping=1e-12)
    assert np.abs(np.einsum("kcn,n->kc", jacobians, left)).max() < 1e-4
    assert np.abs(left).max() > 1e-3


def test_contact_is_being_pushed_without_moving_for_a_while() -> None:
    stall = StallTimes(np.zeros(3))
    velocity = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.0]])
    torque = np.array([[0.1, 0.0], [0.1, 0.0], [0.0, 0.001]])
    for _ in range(25):
        stall = update_stall(stall, velocity, torque, 0.003)
    np.testing.assert_array_equal(fingers_in_contact(stall), [True, False, False])
    stall = update_stall(stall, velocity + 1.0, torque, 0.003)
    assert not fingers_in_contact(stall).any()
