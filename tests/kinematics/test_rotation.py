"""A pose that a finger cannot quite have: the position is exact, the rotation as near as any posture there has it."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.kinematics.orientation import angle_between, matrix_from_quaternion, quaternion_from_vector
from allegro_twin.spec import Side
from allegro_twin.types import Array
from tests.kinematics.hands import EVERY, FINGERS, THUMBS, postures, shortly

Key = tuple[Side, str]
NEARLY = 1e-6  # rad, of what can be attained.


def off(rotation: Array, angle: float, seed: int) -> Array:
    """Turned by an angle about random axes, (n, 3, 3)."""
    axes = np.random.default_rng(seed).normal(size=(len(rotation), 3))
    turn = axes * (angle / np.linalg.norm(axes, axis=1, keepdims=True))
    return np.asarray(rotation @ matrix_from_quaternion(quaternion_from_vector(turn)))


def least_angle(finger: ClosedFormFinger, points: Array, wanted: Array, count: int = 1500, finer: int = 5) -> Array:
    """The least angle of any posture that reaches a point (n, 3), inside the limits, (n,): sampled, and sampled again.

    Along q₀ on the thumb and the pitch on a finger, evenly over all there is, then ever closer around the best.
    """
    thumb = finger.name == "thumb"
    low, high = (finger.lower[0], finger.upper[0]) if thumb else (finger.lower[1:].sum(), finger.upper[1:].sum())
    middle, half, best = np.full(len(points), (low + high) / 2), (high - low) / 2, np.full(len(points), np.inf)
    for samples in (count, *[41] * finer):
        along = np.clip(middle[:, None] + half * np.linspace(-1, 1, samples), low, high)
        grid = np.broadcast_to(points[:, None], (*along.shape, 3))
        solutions = finger.ik(grid, q0=along) if thumb else finger.ik(grid, pitch=along)
        turned = finger.fk(solutions.position).rotation
        angle = np.where(solutions.within, angle_between(turned, wanted[:, None, None]), np.inf).min(axis=-1)
        chosen = np.argmin(angle, axis=1)
        found = np.take_along_axis(angle, chosen[:, None], axis=1)[:, 0]
        middle = np.where(found < best, np.take_along_axis(along, chosen[:, None], axis=1)[:, 0], middle)
        best, half = np.minimum(best, found), half * 3.0 / samples
    return best


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.003, 0.02, 0.3])
@pytest.mark.parametrize("key", shortly(EVERY), ids=str)
def test_no_posture_of_a_dense_sampling_is_turned_nearer(key: Key, noise: float) -> None:
    finger = FINGERS[key]
    q = postures(finger, 40, seed=1)
    pose = finger.fk(q)
    wanted = off(pose.rotation, noise, seed=2)
    best = finger.ik(pose.position, rotation=wanted).best()
    assert best.reached.all()
    np.testing.assert_allclose(finger.fk(best.posture).position, pose.position, rtol=0, atol=1e-12)
    turned = angle_between(finger.fk(best.posture).rotation, wanted)
    np.testing.assert_allclose(best.angle, turned, rtol=0, atol=1e-9)
    assert (best.angle <= least_angle(finger, pose.position, wanted) + NEARLY).all()
    assert (best.angle <= noise + NEARLY).all()
    assert (best.angle > 1e-4).any()  # It is not what the finger can have.


@pytest.mark.slow
@pytest.mark.parametrize("key", THUMBS, ids=str)
def test_almost_half_a_turn_off_is_not_taken_for_almost_there(key: Key) -> None:
    """Both have a small sine, by which the thumb's q₀ is bounded."""
    finger = FINGERS[key]
    pose = finger.fk(postures(finger, 4000, seed=9))
    wanted = off(pose.rotation, 3.0, seed=10)
    best = finger.ik(pose.position, rotation=wanted).best()
    for rows in np.array_split(np.arange(4000), 8):
        assert (
            best.angle[rows] <= least_angle(finger, pose.position[rows], wanted[rows], count=100, finer=0) + NEARLY
        ).all()


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.001, 0.02, 0.1, 1.0, 3.0])
@pytest.mark.parametrize("key", EVERY, ids=str)
def test_of_two_thousand_poses_none_could_be_turned_nearer(key: Key, noise: float) -> None:
    finger = FINGERS[key]
    pose = finger.fk(postures(finger, 2000, seed=3))
    wanted = off(pose.rotation, noise, seed=4)
    best = finger.ik(pose.position, rotation=wanted).best()
    assert best.reached.all()
    for rows in np.array_split(np.arange(2000), 40):
        least = least_angle(finger, pose.position[rows], wanted[rows])
        assert (best.angle[rows] <= least + NEARLY).all()


@pytest.mark.parametrize("key", THUMBS, ids=str)
def test_the_thumb_takes_another_q0_where_that_turns_it_nearer(key: Key) -> None:
    """Rather than the one of the rotation, which it takes where that is the rotation itself."""
    finger = FINGERS[key]
    q = postures(finger, 300, seed=5)
    pose = finger.fk(q)
    exact = finger.ik(pose.position, rotation=pose.rotation)
    np.testing.assert_allclose(exact.best(near=q).posture, q, rtol=0, atol=1e-6)
    kept = np.abs(exact.position[..., 0] - q[:, None, 0]) < 1e-9
    assert kept.all()
    noisy = off(pose.rotation, 0.02, seed=6)
    solutions = finger.ik(pose.position, rotation=noisy)
    assert (np.abs(solutions.position[:, 0, 0] - solutions.position[:, 1, 0]) > 1e-6).mean() > 0.9
    assert solutions.within[:, 0].all()
    assert (solutions.angle[:, 0] <= np.where(solutions.within, solutions.angle, np.inf).min(axis=1)).all()


@pytest.mark.parametrize("key", EVERY, ids=str)
def test_a_margin_leaves_less_to_turn(key: Key) -> None:
    finger = FINGERS[key]
    q = postures(finger, 200, seed=7) * 0.5 + (finger.lower + finger.upper) / 4
    pose = finger.fk(q)
    wanted = off(pose.rotation, 0.5, seed=8)
    free, held = (finger.ik(pose.position, rotation=wanted, margin=margin) for margin in (0.0, 0.2))
    chosen = held.position[held.within]
    assert (chosen >= finger.lower + 0.2 - 1e-8).all()
    assert (chosen <= finger.upper - 0.2 + 1e-8).all()
    assert (held.best().angle >= free.best().angle - NEARLY)[held.reachable].all()
    assert (held.best().angle > free.best().angle + 1e-3)[held.reachable].any()
