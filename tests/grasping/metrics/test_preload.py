"""The least squeeze: what it must be in cases that a pencil solves, and what no squeeze can do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog  # type: ignore[import-untyped]  # Its types are a package of their own.

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.metrics.carrying import least_effort
from allegro_twin.grasping.metrics.contacts import Contacts, make_contacts
from allegro_twin.grasping.metrics.preload import (
    COMPLIANCE,
    FACETS,
    GripForces,
    Preload,
    _cone_facets,
    _grip_matrix,
)
from allegro_twin.types import Array

HALF = 0.03
"""m, between an object's middle and each of two flat pads."""
WEIGHT = np.array([0.0, 0.0, -2.0, 0.0, 0.0, 0.0])


def pads(friction: float, length: float = 0.04) -> Contacts:
    """Two pads of three points each that face each other along x."""
    around = 0.008 * np.array([[0.0, np.cos(a), np.sin(a)] for a in 2.0 * np.pi * np.arange(3) / 3.0])
    points = np.vstack([around - np.array([HALF, 0, 0]), around + np.array([HALF, 0, 0])])
    normals = np.repeat([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], 3, axis=0)
    return make_contacts(points, normals, friction, length=length)


def slides() -> Array:
    """Each pad is moved by three slides of its own, of 1 m/m: a motor's torque is a force, N. (6, 3, 6)."""
    found = np.zeros((6, 3, 6))
    found[:3, :, :3] = found[3:, :, 3:] = np.eye(3)
    return found


def squeezed(friction: float, *loads: Array, limit: float = 10.0, stiffness: float = 1000.0) -> Preload:
    return GripForces(pads(friction), slides(), np.full(6, limit)).least_preload(
        np.full(6, stiffness), np.array(loads or [WEIGHT]), compliance=1e-9
    )


def drawn(seed: int) -> tuple[Contacts, Array, Array, Array]:
    """Contacts around an object, how joints move them, limits and loads."""
    random = np.random.default_rng(seed)
    count, joints = int(random.integers(3, 7)), int(random.integers(4, 9))
    points = 0.04 * random.normal(size=(count, 3))
    inwards = -points / np.linalg.norm(points, axis=1, keepdims=True)
    loads = np.vstack([WEIGHT, 1.3 * WEIGHT[[2, 1, 0, 3, 4, 5]], WEIGHT + 0.01 * random.normal(size=6)])
    touch = make_contacts(points, inwards, 0.7, length=0.04)
    return touch, 0.08 * random.normal(size=(count, 3, joints)), random.uniform(0.3, 0.7, joints), loads


@pytest.mark.parametrize("friction", [0.3, 0.6, 0.9])
def test_two_pads_press_with_half_the_weight_over_friction(friction: float) -> None:
    """Each carries 1 N by friction: N = 1 / µ, more by what a hexagon cuts off the cone; the load comes to the motors
    that hold it, and pressing needs the larger share."""
    found = squeezed(friction)
    least, most = 1.0 / friction, 1.0 / (friction * np.cos(np.pi / 6))
    assert least - 1e-6 <= abs(found.torque[0]) <= most + 1e-6
    assert found.share == pytest.approx(abs(found.torque[0]) / 10.0)


def test_the_forces_of_a_squeeze_move_nothing() -> None:
    found, touch = squeezed(0.6), pads(0.6)
    np.testing.assert_allclose(found.force.sum(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.cross(touch.points, found.force).sum(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(found.torque, np.einsum("kin,ki->n", slides(), found.force), atol=1e-9)


def test_with_every_load_its_forces_stay_in_the_friction_cones() -> None:
    loads = [np.append(2.0 * np.array(way), np.zeros(3)) for way in ((0, 0, -1), (0, 1, 0), (1, 0, 0), (-1, 0, 0))]
    found, touch = squeezed(0.5, *loads), pads(0.5)
    for load in loads:
        shared = found.force - load[:3] / 6.0  # Six equal springs in each direction answer alike.
        normal = np.einsum("ki,ki->k", shared, touch.normals)
        across = np.linalg.norm(shared - normal[:, None] * touch.normals, axis=1)
        assert (across <= 0.5 * normal + 1e-6).all()


def test_a_stronger_hand_needs_a_smaller_share_and_the_same_torque() -> None:
    weak, strong = squeezed(0.6, limit=5.0), squeezed(0.6, limit=10.0)
    assert weak.share == pytest.approx(2.0 * strong.share)
    np.testing.assert_allclose(np.abs(weak.torque[[0, 3]]), np.abs(strong.torque[[0, 3]]), rtol=1e-6)


def test_it_does_not_matter_which_way_motors_turn_nor_by_what_length_torques_are_divided() -> None:
    twisted = np.array([[0.0, 0.0, -2.0, 0.03, 0.0, 0.0]])
    shares = [
        GripForces(pads(0.6, length), sign * slides(), np.full(6, 1e1)).least_preload(np.full(6, 1e3), twisted).share
        for length in (0.02, 0.04, 0.08)
        for sign in (1.0, -1.0)
    ]
    np.testing.assert_allclose(shares, shares[0], rtol=1e-6)
    assert shares[0] > 1.5 * squeezed(0.6).share, "a twist about the line between the pads needs friction of its own"


def test_what_a_finger_loses_to_a_palm_that_the_load_presses_on_is_by_their_springs() -> None:
    """Three contacts of 1 mm/N on a palm that no motor moves, 3000 N/m, and three on a finger's slide of 1000 N/m,
    3 / (3/1000 + 1/1000) = 750 N/m: of 2 N against the palm the finger loses a fifth, and so much it has to press."""
    around = 0.02 * np.array([[np.cos(a), np.sin(a), 0.0] for a in 2.0 * np.pi * np.arange(3) / 3.0])
    touch = make_contacts(
        np.vstack([around - np.array([0, 0, HALF]), around + np.array([0, 0, HALF])]),
        np.repeat([[0, 0, 1.0], [0, 0, -1.0]], 3, axis=0), 0.6, length=0.04,
    )  # fmt: skip
    moved = np.zeros((6, 3, 1))
    moved[3:, 2] = 1.0
    found = GripForces(touch, moved, np.array([10.0])).least_preload(np.array([1000.0]), WEIGHT[None], compliance=1e-3)
    assert -found.torque[0] == pytest.approx(0.4)


def test_without_a_load_nothing_is_asked() -> None:
    assert squeezed(0.6, np.zeros(6)).share == pytest.approx(0.0, abs=1e-7)  # As exact as the solver is.


def test_a_share_above_one_says_how_much_too_weak_a_hand_is() -> None:
    assert squeezed(0.3, limit=1.0).share > 3.0


def test_two_points_hold_nothing_for_they_let_it_turn_about_the_line_between_them() -> None:
    touch = make_contacts([[-HALF, 0, 0], [HALF, 0, 0]], [[1.0, 0, 0], [-1.0, 0, 0]], 0.8, length=0.04)
    found = GripForces(touch, slides()[[0, 3]], np.full(6, 1e1)).least_preload(np.full(6, 1e3), WEIGHT[None])
    assert np.isinf(found.share)
    assert np.isnan(found.torque).all()


def test_pads_on_one_side_hold_nothing() -> None:
    one = pads(0.6)
    both = make_contacts(
        np.vstack([one.points[:3], one.points[:3] + np.array([0.0, 0.03, 0.0])]),
        np.tile([1.0, 0, 0], (6, 1)),
        0.6,
        length=0.04,
    )
    assert np.isinf(GripForces(both, slides(), np.full(6, 1e1)).least_preload(np.full(6, 1e3), WEIGHT[None]).share)


def test_shapes_that_do_not_fit_are_named() -> None:
    with pytest.raises(ConfigError, match=r"jacobians have the shape \(6, 3, 6\), not \(5, 3, 6\)"):
        GripForces(pads(0.5), slides()[:5], np.ones(6)).least_preload(np.ones(6), WEIGHT[None])


@pytest.mark.parametrize("seed", range(12))
def test_the_share_is_that_of_the_linear_program_and_of_equal_squeezes_the_weakest_is_found(seed: int) -> None:
    """The program itself, all of its rows written out for every load, in SciPy's words."""
    touch, moved, limit, loads = drawn(seed)
    count, joints = len(touch), len(limit)
    found = GripForces(touch, moved, limit).least_preload(np.full(joints, 10.0), loads)

    grip, flat = _grip_matrix(touch), moved.reshape(3 * count, joints)
    springs = np.linalg.inv(flat @ flat.T / 10.0 + COMPLIANCE * np.eye(3 * count))
    scaled = loads * np.array([1.0, 1.0, 1.0, *[1.0 / touch.length] * 3])
    answers = [np.zeros(3 * count)]
    answers += [-springs @ grip.T @ np.linalg.solve(grip @ springs @ grip.T, load) for load in scaled]
    cones = _cone_facets(touch, FACETS)
    upper = [np.hstack([cones, np.zeros((len(cones), 1))])] * len(answers)
    right = [-cones @ answer for answer in answers]
    for sign in (1.0, -1.0):
        upper += [np.hstack([sign * flat.T, -limit[:, None]])] * len(answers)
        right += [-sign * flat.T @ answer for answer in answers]
    least = linprog(
        np.append(np.zeros(3 * count), 1.0), A_ub=np.vstack(upper), b_ub=np.concatenate(right),
        A_eq=np.hstack([grip, np.zeros((6, 1))]), b_eq=np.zeros(6), bounds=(None, None),
    )  # fmt: skip
    assert np.isfinite(found.share) == least.success
    if least.success:
        assert found.share == pytest.approx(least.fun, abs=1e-4)
        inside = np.vstack(upper) @ np.append(found.force.ravel(), found.share) - np.concatenate(right)
        assert inside.max() < 1e-5
        assert np.linalg.norm(found.force) <= np.linalg.norm(least.x[:-1]) * (1.0 + 1e-3)


@pytest.mark.parametrize("seed", range(12))
def test_limit_analysis_needs_what_the_linear_program_of_each_load_needs(seed: int) -> None:
    """The same pyramids in HiGHS."""
    touch, moved, limit, loads = drawn(seed)
    expected = max(least_effort(touch, moved, limit, load, edges=FACETS).share for load in loads)
    assert GripForces(touch, moved, limit).limit_share(loads) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("seed", range(12))
def test_no_squeeze_needs_less_than_limit_analysis(seed: int) -> None:
    touch, moved, limit, loads = drawn(seed)
    squeeze = GripForces(touch, moved, limit).least_preload(np.full(len(limit), 10.0), loads)
    assert GripForces(touch, moved, limit).limit_share(loads) <= squeeze.share + 1e-6


def test_a_palm_that_the_load_presses_on_carries_it_without_a_motor() -> None:
    """Springs let the finger lose a part of its squeeze, so that it has to press before; forces alone do not."""
    around = 0.02 * np.array([[np.cos(a), np.sin(a), 0.0] for a in 2.0 * np.pi * np.arange(3) / 3.0])
    touch = make_contacts(
        np.vstack([around - np.array([0, 0, HALF]), around + np.array([0, 0, HALF])]),
        np.repeat([[0, 0, 1.0], [0, 0, -1.0]], 3, axis=0), 0.6, length=0.04,
    )  # fmt: skip
    moved, limit = np.zeros((6, 3, 1)), np.array([10.0])
    moved[3:, 2] = 1.0
    assert GripForces(touch, moved, limit).limit_share(WEIGHT[None]) == pytest.approx(0.0, abs=1e-6)
    assert GripForces(touch, moved, limit).least_preload(np.array([1000.0]), WEIGHT[None], compliance=1e-3).share > 0.03
    assert GripForces(touch, moved, limit).limit_share(-WEIGHT[None]) == pytest.approx(0.2, abs=1e-5), (
        "lifted off, all of it"
    )


def test_by_limit_analysis_too_two_points_turn_and_pads_on_one_side_push() -> None:
    two = make_contacts([[-HALF, 0, 0], [HALF, 0, 0]], [[1.0, 0, 0], [-1.0, 0, 0]], 0.8, length=0.04)
    about = np.array([[0.0, 0.0, 0.0, 0.01, 0.0, 0.0]])
    assert np.isinf(GripForces(two, slides()[[0, 3]], np.full(6, 10.0)).limit_share(about))
    assert np.isfinite(GripForces(pads(0.6), slides(), np.full(6, 10.0)).limit_share(np.zeros((1, 6))))
    one = make_contacts(np.eye(3) * 0.01, np.tile([1.0, 0, 0], (3, 1)), 0.6, length=0.04)
    assert np.isinf(GripForces(one, slides()[:3], np.full(6, 10.0)).limit_share(WEIGHT[None]))
    with pytest.raises(ConfigError, match=r"jacobians have the shape \(6, 3, 6\), not \(5, 3, 6\)"):
        GripForces(pads(0.5), slides()[:5], np.ones(6)).limit_share(WEIGHT[None])
