"""Metrics of contacts against what is known in closed form, and what no change of frame or unit may change."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.metrics.contacts import Contacts, cone_forces, cone_wrenches, make_contacts
from allegro_twin.grasping.metrics.quality import closure_margin, grasp_quality, qp_residual, wrench_quality
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.types import Array

HALF = 0.03  # m
FACES = np.vstack([np.eye(3), -np.eye(3)])


def cube(friction: float, length: float = HALF) -> Contacts:
    """A contact in the middle of each face of a cube."""
    return make_contacts(HALF * FACES, -FACES, friction, length=length)


def opposed(friction: float, torsion: float) -> Contacts:
    """Two contacts that face each other."""
    return make_contacts([[HALF, 0, 0], [-HALF, 0, 0]], [[-1, 0, 0], [1, 0, 0]], friction, torsion, length=HALF)


def on_sphere(points: Array, friction: float = 0.6, torsion: float = 0.0) -> Contacts:
    out = np.asarray(points, dtype=np.float64)
    out = out / np.linalg.norm(out, axis=1, keepdims=True)
    return make_contacts(HALF * out, -out, friction, torsion, length=HALF)


TRIPOD = [[1, 0, 0], [-0.5, math.sqrt(0.75), 0], [-0.5, -math.sqrt(0.75), 0]]
TETRAHEDRON = [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]


@pytest.mark.parametrize("friction", [0.1, 0.5, 0.8])
@pytest.mark.parametrize("length", [HALF, 2 * HALF])
def test_a_cube_held_at_six_faces_has_the_epsilon_that_one_can_work_out(friction: float, length: float) -> None:
    """With pyramids of 4 edges along the axes the hull is a square times ±µ b on each torque axis (b: half edge over
    length), ε = µ b / √3; with the cones themselves µ b √(2/3), and 8 edges along the axes already give that."""
    reach = friction * HALF / length
    assert grasp_quality(cube(friction, length), 4).epsilon == pytest.approx(reach / math.sqrt(3), rel=1e-9)
    assert grasp_quality(cube(friction, length), 8).epsilon == pytest.approx(reach * math.sqrt(2 / 3), rel=1e-9)
    assert grasp_quality(cube(friction, length), 16).epsilon == pytest.approx(reach * math.sqrt(2 / 3), rel=1e-9)


def test_the_hull_of_the_axes_has_the_ball_and_volume_of_a_cross_polytope() -> None:
    """1/√6 and 2⁶/6!, in six dimensions; half of it, with 0 in its flat side, has half the volume and no ball."""
    axes = np.vstack([np.eye(6), -np.eye(6)])
    assert wrench_quality(axes) == pytest.approx((1 / math.sqrt(6), 2**6 / math.factorial(6)))
    assert wrench_quality(axes[:-1]) == pytest.approx((0.0, 2**5 / math.factorial(6)))


@pytest.mark.parametrize("friction", [0.3, 0.8])
def test_more_edges_find_more_and_never_more_than_the_cone(friction: float) -> None:
    sphere = on_sphere(np.array(TETRAHEDRON, dtype=float), friction)
    found = [grasp_quality(sphere, edges) for edges in (4, 8, 16, 32)]
    assert all(a.epsilon <= b.epsilon + 1e-12 and a.volume < b.volume for a, b in pairwise(found))
    force, moment, owner = cone_forces(sphere, 64)
    normal = np.einsum("gi,gi->g", force, sphere.normals[owner])
    np.testing.assert_allclose(normal, 1.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(force - normal[:, None] * sphere.normals[owner], axis=1), friction)
    assert not moment.any()


@pytest.mark.parametrize("torsion", [0.001, 0.005, 0.01])
def test_two_opposed_soft_contacts_have_a_ball_and_hard_ones_none(torsion: float) -> None:
    """With 4 edges across the line between them, ε = 1 / √(2/µ² + 1/τ²), τ = µₜ / length."""
    friction, twist = 0.5, torsion / HALF
    found = grasp_quality(opposed(friction, torsion), 4).epsilon
    assert found == pytest.approx(1 / math.sqrt(2 / friction**2 + 1 / twist**2), rel=1e-9)
    assert grasp_quality(opposed(friction, 0.0), 16) == (0.0, 0.0)
    assert closure_margin(opposed(friction, 0.0)) == 0.0
    assert closure_margin(opposed(friction, torsion)) == pytest.approx(1.0)


def test_a_ball_is_in_closure_with_three_contacts_round_it_and_not_with_three_on_one_side() -> None:
    """Hard contacts with friction at 120° on a great circle, Nguyen 1988: any two of them and a third."""
    assert closure_margin(on_sphere(np.array(TRIPOD))) > 0.1
    assert grasp_quality(on_sphere(np.array(TRIPOD))).epsilon > 0.05
    above = on_sphere(np.array(TRIPOD) + np.array([0, 0, 1.5]))
    assert closure_margin(above) <= 0.0
    assert grasp_quality(above).epsilon == 0.0


def test_four_contacts_at_a_tetrahedrons_corners_need_friction_to_hold_a_ball() -> None:
    assert grasp_quality(on_sphere(np.array(TETRAHEDRON), 0.0)) == (0.0, 0.0)
    assert closure_margin(on_sphere(np.array(TETRAHEDRON), 0.0)) == 0.0
    assert closure_margin(on_sphere(np.array(TETRAHEDRON), 0.1)) > 0.0


def test_one_contact_or_none_is_no_grasp() -> None:
    for points in (np.zeros((0, 3)), np.array([[1.0, 0, 0]])):
        assert (
            grasp_quality(on_sphere(points) if len(points) else make_contacts(points, points, 0.5, length=1.0)).epsilon
            == 0.0
        )
    assert closure_margin(on_sphere(np.array([[1.0, 0, 0]]))) == -math.inf
    assert qp_residual(make_contacts(np.zeros((0, 3)), np.zeros((0, 3)), 0.5, length=1.0)) == 1.0


def grasps() -> st.SearchStrategy[tuple[Contacts, int]]:
    """Four to six contacts somewhere on a ball, and a seed."""
    return st.tuples(st.integers(4, 6), st.integers(0, 10_000)).map(
        lambda drawn: (on_sphere(np.random.default_rng(drawn[1]).normal(size=(drawn[0], 3)), 0.6, 0.005), drawn[1])
    )


@settings(max_examples=15, deadline=None)
@given(grasps())
def test_neither_the_frame_nor_the_unit_of_length_changes_a_figure(drawn: tuple[Contacts, int]) -> None:
    touch, seed = drawn
    rng = np.random.default_rng(seed + 1)
    turn, shift, scale = matrix_from_quaternion(rng.normal(size=4)), rng.normal(size=3), 1000.0
    moved = make_contacts(
        scale * (touch.points @ turn.T + shift), touch.normals @ turn.T, touch.friction, scale * touch.torsion,
        centre=scale * shift, length=scale * touch.length, tangents=touch.tangents @ turn.T,
    )  # fmt: skip
    there, here = grasp_quality(moved, 6), grasp_quality(touch, 6)
    assert there.epsilon == pytest.approx(here.epsilon, abs=1e-9)
    assert there.volume == pytest.approx(here.volume, rel=1e-6)
    assert closure_margin(moved, 6) == pytest.approx(closure_margin(touch, 6), abs=1e-7)
    in_metres = replace(moved, points=touch.points + shift, centre=shift, length=touch.length, torsion=touch.torsion)
    straight = replace(in_metres, normals=touch.normals, tangents=touch.tangents)
    assert qp_residual(straight, 6) == pytest.approx(
        qp_residual(touch, 6), abs=1e-6
    )  # Its six pushes are the frame's axes.


@settings(max_examples=15, deadline=None)
@given(grasps())
def test_the_two_tests_of_closure_agree_and_friction_only_helps(drawn: tuple[Contacts, int]) -> None:
    touch, _ = drawn
    less = make_contacts(touch.points, touch.normals, 0.3, touch.torsion / 2, length=touch.length)
    for grasp in (touch, less):
        assert (closure_margin(grasp, 6) > 1e-9) == (grasp_quality(grasp, 6).epsilon > 1e-9)
    assert grasp_quality(touch, 6).epsilon >= grasp_quality(less, 6).epsilon - 1e-9


def test_a_longer_length_makes_torques_small_and_forces_stay() -> None:
    near, far = cone_wrenches(cube(0.5, HALF)), cone_wrenches(cube(0.5, 10 * HALF))
    np.testing.assert_array_equal(near[:, :3], far[:, :3])
    np.testing.assert_allclose(near[:, 3:], 10 * far[:, 3:])


WRONG = [
    ({"points": [[0, 0]]}, r"points have the shape \(k, 3\), not \(1, 2\)"),
    ({"points": [[0, 0, math.nan]]}, r"points\[0\] is \[0.0, 0.0, nan\]; every number must be finite"),
    ({"normals": [[0, 0, 0]]}, r"normals\[0\] has no length"),
    ({"normals": [[0, 0, 1], [0, 1, 0]]}, "1 contact points and 2 normals: one each"),
    ({"friction": -0.1}, "friction must be finite and not below 0"),
    ({"friction": [0.1, 0.2]}, "friction needs one value or 1, one a contact; it has 2"),
    ({"length": 0.0}, "the length that torques are divided by is 0.0 m; it must be above 0"),
    ({"tangents": [[0, 0, 1]]}, "tangents must be one a contact, at right angles to its normal"),
    ({"centre": [0, 0]}, r"the centre of mass is three finite numbers, m, not \[0.0, 0.0\]"),
]


@pytest.mark.parametrize(("change", "answer"), WRONG)
def test_wrong_contacts_are_answered_in_a_line(change: dict[str, object], answer: str) -> None:
    right: dict[str, object] = {"points": [[0, 0, 0]], "normals": [[0, 0, 1]], "friction": 0.5, "length": 0.1}
    with pytest.raises(ConfigError, match=answer):
        make_contacts(**(right | change))  # type: ignore[arg-type]  # Wrong on purpose.


def test_without_scipy_the_answer_is_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "scipy"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "scipy", None)
    with pytest.raises(ConfigError, match=r"need SciPy: pip install 'allegro-twin\[objects\]'"):
        grasp_quality(cube(0.5))
