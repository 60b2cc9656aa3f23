"""On joint 1's axis, where the thumb's q₁ moves nothing, and ever so near to it, postures are found all the same."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.kinematics.closed_form.geometry import load_geometry
from allegro_twin.spec import Side
from allegro_twin.types import Array
from tests.kinematics.hands import FINGERS, THUMBS, held, postures, solve

Key = tuple[Side, str]
DISTANCES = [0.0, 1e-16, 1e-14, *10.0 ** np.arange(-13, -3)]


def beside(finger: ClosedFormFinger, distance: float, n: int = 400) -> Array:
    """Postures with the tip so far from joint 1's axis, m, q₁ away from its limits, shape (about n, 4)."""
    link, tip = load_geometry("allegro", "thumb").links
    q = postures(finger, 2 * n, seed=1)
    q[:, 1] = finger.lower[1] + 0.1 + 0.8 * (q[:, 1] - finger.lower[1])
    side = np.where(np.arange(2 * n) % 2, 1.0, -1.0)
    q[:, 2] = finger.lower[2] + (q[:, 2] - finger.lower[2]) * 0.2
    q[:, 3] = np.arcsin((side * distance - link * np.sin(q[:, 2])) / tip) - q[:, 2]
    return np.asarray(q[((q > finger.lower) & (q < finger.upper)).all(axis=1)])


@pytest.mark.slow
@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("key", THUMBS, ids=str)
def test_a_posture_beside_the_axis_is_found_in_every_mode(key: Key, distance: float) -> None:
    finger = FINGERS[key]
    q = beside(finger, distance)
    assert len(q) > 100
    points = finger.fk(q).position
    for given_ in [*held(finger, q), {"near": q}, {}]:
        solutions = solve(finger, points, given_)
        assert solutions.reachable.all(), given_.keys()
        found = finger.fk(solutions.best(near=q).posture).position
        assert np.linalg.norm(found - points, axis=1).max() <= 3e-13, given_.keys()


@pytest.mark.parametrize("distance", [d for d in DISTANCES if d > 1e-12])
@pytest.mark.parametrize("key", THUMBS, ids=str)
def test_with_psi_q1_is_as_certain_as_the_square_root_of_rounding_over_the_distance(key: Key, distance: float) -> None:
    finger = FINGERS[key]
    q = beside(finger, distance)
    best = finger.ik(finger.fk(q).position, psi=q[:, 2:].sum(axis=1)).best(near=q)
    assert np.abs(best.posture - q)[:, [0, 2, 3]].max() <= 1e-9
    assert np.abs(best.posture - q)[:, 1].max() <= 10 * np.sqrt(1e-16 / distance)


@pytest.mark.parametrize("key", THUMBS, ids=str)
def test_on_the_axis_psi_leaves_q1_at_zero_a_wish_takes_it_along_and_a_pose_says_it(key: Key) -> None:
    finger = FINGERS[key]
    q = beside(finger, 0.0)
    pose, psi = finger.fk(q), q[:, 2:].sum(axis=1)
    with_psi = finger.ik(pose.position, psi=psi)
    there = with_psi.within & (np.abs(with_psi.position - q[:, None])[..., 0] < 1e-6)
    assert (with_psi.position[there][:, 1] == 0.0).all()
    np.testing.assert_allclose(finger.ik(pose.position, near=q).position[:, 0], q, rtol=0, atol=1e-9)
    posed = finger.ik(pose.position, rotation=pose.rotation).best(near=q)
    np.testing.assert_allclose(posed.posture, q, rtol=0, atol=1e-6)
    assert posed.angle.max() <= 1e-9


@settings(max_examples=200, deadline=None)
@example(("right", "thumb"), 30, -11.572123704123033)
@given(st.sampled_from(THUMBS), st.integers(0, 99), st.floats(-12.0, -4.0))
def test_one_target_beside_the_axis_is_solved_as_in_a_batch(key: Key, row: int, exponent: float) -> None:
    finger = FINGERS[key]
    q = beside(finger, 10.0**exponent)[row]
    point, psi = finger.fk(q).position, q[2] + q[3]
    one, batch = finger.ik(point, psi=psi), finger.ik(point[None], psi=[psi])
    np.testing.assert_allclose(one.position, batch.position[0], rtol=0, atol=1e-12)
    x, y, z = point.tolist()
    found = finger.scalar.at_psi(x, y, z, float(psi))
    assert found
    assert one.within.any()
    # Its way into the base rounds otherwise, and q₁ is no more certain than that: two solutions may come out as one.
    apart = np.abs(np.array(found)[:, None] - one.position[one.within][None]).max(axis=-1)
    tolerance = 10 * np.sqrt(1e-16 / 10.0**exponent)
    assert apart.min(axis=0).max() <= tolerance
    assert apart.min(axis=1).max() <= tolerance
