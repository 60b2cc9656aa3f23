"""A position alone leaves one freedom, which is spent as asked."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.spec import Side
from allegro_twin.types import Array
from tests.kinematics.hands import EVERY, FINGERS, THUMBS, postures, shortly

Key = tuple[Side, str]


def family(finger: ClosedFormFinger, point: Array) -> Array:
    """Every posture inside the limits that reaches a point, in steps of 1 mrad, shape (N, 4)."""
    thumb = finger.name == "thumb"
    along = np.arange(finger.lower[0], finger.upper[0], 1e-3) if thumb else np.arange(-0.6, 5.05, 1e-3)
    points = np.broadcast_to(point, (along.size, 3))
    solutions = finger.ik(points, q0=along) if thumb else finger.ik(points, pitch=along)
    return solutions.position[solutions.within]


def room(finger: ClosedFormFinger, q: Array) -> Array:
    least: Array = np.minimum(q - finger.lower, finger.upper - q).min(axis=-1)
    return least


@pytest.mark.parametrize("key", shortly(EVERY), ids=str)
def test_every_point_that_a_posture_reaches_is_reached(key: Key) -> None:
    """Inside, and where it is hardest: with joints at their limits and the elbow straight."""
    finger = FINGERS[key]
    q = postures(finger, 6000)
    rng = np.random.default_rng(1)
    at_limit = rng.random((3000, 4)) < 0.4
    q[:3000] = np.where(at_limit, np.where(rng.random((3000, 4)) < 0.5, finger.lower, finger.upper), q[:3000])
    q[3000:3300, 2:] = rng.normal(scale=1e-3, size=(300, 2))
    points = finger.fk(q).position
    solutions = finger.ik(points)
    assert solutions.reachable.all()
    assert solutions.position.shape == (6000, 1, 4)
    assert np.linalg.norm(finger.fk(solutions.position[:, 0]).position - points, axis=1).max() <= 1e-12


@pytest.mark.parametrize("key", EVERY, ids=str)
def test_near_a_posture_that_reaches_it_the_answer_is_that_posture(key: Key) -> None:
    finger = FINGERS[key]
    q = postures(finger, 3000, seed=2)
    solutions = finger.ik(finger.fk(q).position, near=q)
    np.testing.assert_allclose(solutions.position[:, 0], q, rtol=0, atol=1e-6)


@pytest.mark.parametrize("key", EVERY, ids=str)
def test_no_posture_of_a_dense_sampling_is_nearer(key: Key) -> None:
    finger = FINGERS[key]
    near = postures(finger, 30, seed=4)
    for point, wish in zip(finger.fk(postures(finger, 30, seed=3)).position, near, strict=True):
        found = finger.ik(point, near=wish).position[0]
        sampled = np.linalg.norm(family(finger, point) - wish, axis=-1).min(initial=np.inf)
        assert np.linalg.norm(found - wish) <= sampled + 1e-7


@pytest.mark.parametrize("key", EVERY, ids=str)
def test_without_a_wish_no_posture_of_a_dense_sampling_is_further_from_the_limits(key: Key) -> None:
    finger = FINGERS[key]
    for point in finger.fk(postures(finger, 30, seed=5)).position:
        found = finger.ik(point).position[0]
        assert room(finger, found) >= room(finger, family(finger, point)).max(initial=-np.inf) - 1e-7


@pytest.mark.parametrize("key", THUMBS, ids=str)
def test_where_the_best_of_the_thumb_has_rivals_it_is_still_the_best(key: Key) -> None:
    """One point in two hundred has two postures that leave more room to the limits than those beside them."""
    finger = FINGERS[key]
    points, wish = finger.fk(postures(finger, 2000, seed=7)).position, postures(finger, 2000, seed=8)
    along = np.broadcast_to(np.linspace(finger.lower[0], finger.upper[0], 200), (2000, 200))
    sampled = finger.ik(np.broadcast_to(points[:, None], (2000, 200, 3)), q0=along)
    rooms = np.where(sampled.within, room(finger, sampled.position), -np.inf).max(axis=(1, 2))
    ways = np.linalg.norm(sampled.position - wish[:, None, None], axis=-1)
    assert (room(finger, finger.ik(points).position[:, 0]) >= rooms - 1e-7).all()
    nearest = np.linalg.norm(finger.ik(points, near=wish).position[:, 0] - wish, axis=-1)
    assert (nearest <= np.where(sampled.within, ways, np.inf).min(axis=(1, 2)) + 1e-7).all()


@pytest.mark.parametrize("key", EVERY, ids=str)
def test_best_takes_the_branch_nearest_to_the_posture_given(key: Key) -> None:
    finger = FINGERS[key]
    q = postures(finger, 4000, seed=6)
    points = finger.fk(q).position
    solutions = finger.ik(points, q0=q[:, 0]) if finger.name == "thumb" else finger.ik(points, pitch=q[:, 1:].sum(1))
    several = solutions.within.sum(axis=1) > 1
    assert several.any()
    np.testing.assert_allclose(solutions.best(near=q).posture, q, rtol=0, atol=1e-6)
    furthest_from_limits = solutions.best().posture
    most = np.where(solutions.within, room(finger, solutions.position), -np.inf).max(axis=1)
    np.testing.assert_array_equal(room(finger, furthest_from_limits), most)
    assert (np.abs(furthest_from_limits - q).max(axis=1)[several] > 1e-3).any()
