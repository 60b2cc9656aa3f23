"""What it takes to carry a load, against statics that one can do by hand and against another solver."""

from __future__ import annotations

import math

import numpy as np
import pytest
from qpsolvers import solve_qp

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.metrics.carrying import least_effort, least_normal_force, weight_load
from allegro_twin.grasping.metrics.contacts import Contacts, cone_forces, cone_wrenches, make_contacts
from allegro_twin.grasping.metrics.quality import PUSH, qp_residual
from allegro_twin.types import Array
from tests.grasping.metrics.test_quality import HALF, TETRAHEDRON, on_sphere, opposed


def test_a_pinch_carries_a_weight_with_its_half_over_friction_at_each_finger() -> None:
    """2 µ N = m g, so that N₁ + N₂ = m g / µ."""
    needed = least_normal_force(opposed(0.5, 0.0), [weight_load(0.1), weight_load(0.2)])
    np.testing.assert_allclose(needed, [0.1 * 9.81 / 0.5, 0.2 * 9.81 / 0.5])


def test_along_the_line_of_a_pinch_one_finger_carries_and_sideways_pull_is_free() -> None:
    assert least_normal_force(opposed(0.5, 0.0), weight_load(0.1, (1, 0, 0))) == pytest.approx(0.981)


def test_a_finger_below_carries_what_presses_on_it_and_not_what_lifts() -> None:
    below = make_contacts([[0, 0, -HALF]], [[0, 0, 1]], 0.5, length=HALF)
    np.testing.assert_allclose(
        least_normal_force(below, [weight_load(0.1), weight_load(0.1, (0, 0, 1))]), [0.981, math.inf]
    )
    jacobians = np.zeros((1, 3, 1))
    jacobians[0, 2, 0] = 1.0
    assert least_effort(below, jacobians, np.ones(1), weight_load(0.1)).torque[0] == pytest.approx(0.981)
    assert least_effort(below, jacobians, np.ones(1), weight_load(0.1, (0, 0, 1))).share == math.inf


def test_a_hard_pinch_cannot_carry_a_twist_and_a_soft_one_can() -> None:
    """2 µₜ N = τ, so that N₁ + N₂ = τ / µₜ."""
    twist = [0, 0, 0, 0.004, 0, 0]
    assert least_normal_force(opposed(0.5, 0.0), twist) == math.inf
    assert least_normal_force(opposed(0.5, 0.01), twist) == pytest.approx(0.4)


def test_no_contacts_carry_nothing() -> None:
    none = make_contacts(np.zeros((0, 3)), np.zeros((0, 3)), 0.5, length=1.0)
    np.testing.assert_array_equal(least_normal_force(none, [weight_load(0.1), np.zeros(6)]), [math.inf, 0.0])
    effort = least_effort(none, np.zeros((0, 3, 2)), np.ones(2), weight_load(0.1))
    assert effort.share == math.inf
    assert np.isnan(effort.torque).all()


def two_sliders() -> Array:
    """A joint at each finger of a pinch that pushes along x, and one that lifts along z: (2, 3, 4)."""
    jacobians = np.zeros((2, 3, 4))
    jacobians[0, 0, 0] = jacobians[1, 0, 1] = jacobians[0, 2, 2] = jacobians[1, 2, 3] = 1.0
    return jacobians


def test_the_joints_effort_is_that_of_the_joint_that_is_worst_off() -> None:
    """Each finger gives half the weight along z and m g / 2 µ along x; limits tell who is worst off."""
    load = 0.1 * 9.81
    effort = least_effort(opposed(0.5, 0.0), two_sliders(), np.array([2.0, 4.0, 1.0, 1.0]), weight_load(0.1))
    assert effort.share == pytest.approx(load / 2 / 0.5 / 2.0)
    np.testing.assert_allclose(np.abs(effort.torque[:2]), load / 2 / 0.5, atol=1e-9)
    np.testing.assert_allclose(effort.torque[2:].sum(), load)
    np.testing.assert_allclose(effort.normal_force, load / 2 / 0.5)


def test_a_stronger_joint_is_given_what_a_weaker_one_cannot() -> None:
    """Four sliders, and the weight along x, onto one finger: there is no choice; a bracing of both, none."""
    effort = least_effort(opposed(0.5, 0.0), two_sliders(), np.array([0.5, 4.0, 1.0, 1.0]), weight_load(0.1, (1, 0, 0)))
    assert effort.share == pytest.approx(0.981 / 0.5)
    other = least_effort(opposed(0.5, 0.0), two_sliders(), np.array([0.5, 4.0, 1.0, 1.0]), weight_load(0.1, (-1, 0, 0)))
    assert other.share == pytest.approx(0.981 / 4.0)


def test_spin_in_the_jacobian_charges_the_twist_to_a_joint() -> None:
    """A joint that turns the finger about the line of the pinch carries half the twist with a soft contact."""
    jacobians = np.concatenate([two_sliders(), np.zeros((2, 3, 4))], axis=1)
    jacobians[:, 3, 2] = 1.0
    effort = least_effort(opposed(0.5, 0.01), jacobians, np.array([9.0, 9.0, 0.01, 9.0]), [0, 0, 0, 0.004, 0, 0])
    assert effort.torque[2] == pytest.approx(-0.004)
    hard = least_effort(opposed(0.5, 0.01), two_sliders(), np.ones(4), [0, 0, 0, 0.004, 0, 0])
    assert hard.share == math.inf


def test_effort_and_force_are_those_that_balance_the_load() -> None:
    touch = on_sphere(np.array(TETRAHEDRON), 0.4, 0.004)
    jacobians = np.random.default_rng(4).normal(scale=0.05, size=(4, 6, 16))
    effort = least_effort(touch, jacobians, np.full(16, 0.3), weight_load(0.3))
    assert np.abs(effort.torque).max() / 0.3 == pytest.approx(effort.share)
    assert effort.normal_force.sum() >= least_normal_force(touch, weight_load(0.3))[0] - 1e-9


def by_another_solver(touch: Contacts, edges: int) -> float:
    """The residual's six problems as they are written down, by an active-set solver of quadratic programs."""
    half = make_contacts(
        touch.points, touch.normals, touch.friction / 2, touch.torsion / 2, length=touch.length, tangents=touch.tangents
    )
    points, owner, left = cone_wrenches(half, edges), cone_forces(half, edges)[2], []
    mine = (owner == np.arange(len(touch))[:, None]).astype(float)
    for load in PUSH * np.vstack([np.eye(6)[:3], -np.eye(6)[:3]]):
        found = solve_qp(
            points @ points.T + 1e-10 * np.eye(len(points)), points @ load, np.vstack([mine, -np.ones(len(points))]),
            np.append(np.ones(len(touch)), -1.0), lb=np.zeros(len(points)), solver="daqp",
        )  # fmt: skip
        assert found is not None
        left.append(np.linalg.norm(points.T @ found + load))
    return float(np.mean(left))


@pytest.mark.parametrize("seed", range(6))
def test_the_residual_is_that_of_the_quadratic_program(seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(4, 3)) + np.array([0, 0, 0.7 * (seed % 3)])
    touch = on_sphere(points, 0.6, 0.02)
    assert qp_residual(touch, 4) == pytest.approx(by_another_solver(touch, 4), abs=1e-8)


def test_the_residual_of_a_firm_grasp_is_nothing_and_of_one_finger_what_it_presses() -> None:
    assert qp_residual(on_sphere(np.array(TETRAHEDRON), 0.8, 0.01)) == pytest.approx(0.0, abs=1e-7)
    # One frictionless contact has to press with 1 N, of which a push of 0.1 N along it takes a tenth off.
    alone = make_contacts([[HALF, 0, 0]], [[-1, 0, 0]], 0.0, length=HALF)
    assert qp_residual(alone) == pytest.approx(np.mean([0.9, 1.1, *[math.hypot(1.0, 0.1)] * 4]), abs=1e-6)


def test_shapes_that_do_not_fit_are_answered_in_a_line() -> None:
    with pytest.raises(ConfigError, match=r"jacobians have the shape \(2, 3 or 6, joints\), not \(2, 4, 4\)"):
        least_effort(opposed(0.5, 0.0), np.zeros((2, 4, 4)), np.ones(4), weight_load(0.1))
    with pytest.raises(ConfigError, match="limit is 4 torques above 0"):
        least_effort(opposed(0.5, 0.0), two_sliders(), np.zeros(4), weight_load(0.1))
    with pytest.raises(ConfigError, match="a load is six finite numbers"):
        least_normal_force(opposed(0.5, 0.0), [1.0, 2.0])
