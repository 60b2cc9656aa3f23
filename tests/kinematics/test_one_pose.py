"""One target gives what a batch gives, in every mode, and everything that can be asked of it."""

from __future__ import annotations

from math import inf, nan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.kinematics.orientation import matrix_from_quaternion, quaternion_from_vector, quaternion_product
from allegro_twin.kinematics.solutions import Solutions
from allegro_twin.spec import Side
from allegro_twin.types import Array
from tests.kinematics.hands import EVERY, FINGERS, held, postures, shortly, solve

Key = tuple[Side, str]
SAME = 1e-12  # rad: sums, products and roots round alike in both; an arc tangent may end in another digit.


def asked(finger: ClosedFormFinger, q: Array, seed: int) -> list[dict[str, Array]]:
    """Everything that can be asked for with the tip positions of postures (n, 4), exact poses and noisy ones."""
    rng = np.random.default_rng(seed)
    pose = finger.fk(q)
    noise = quaternion_from_vector(rng.normal(scale=0.05, size=(len(q), 3)))
    near = rng.uniform(finger.lower, finger.upper, q.shape)
    orientations = {"quaternion": pose.quaternion}, {"euler": pose.euler}, {"rotation": _noisy(pose.quaternion, noise)}
    return [*held(finger, q), *orientations, {"near": near}, {"near": q}, {}]


def _noisy(quaternion: Array, noise: Array) -> Array:
    return matrix_from_quaternion(quaternion_product(quaternion, noise))


def agree(one: Solutions, batch: Solutions, row: int) -> None:
    np.testing.assert_allclose(one.position, batch.position[row], rtol=0, atol=SAME)
    np.testing.assert_array_equal(one.within, batch.within[row])
    np.testing.assert_array_equal(one.exists, batch.exists[row])
    np.testing.assert_allclose(one.angle, batch.angle[row], rtol=0, atol=SAME)


@pytest.mark.slow
@pytest.mark.parametrize("key", shortly(EVERY), ids=str)
def test_one_target_gives_what_a_batch_gives(key: Key) -> None:
    """Postures anywhere, with a straight elbow and at limits, and points anywhere, most of which are out of reach."""
    finger = FINGERS[key]
    q = postures(finger, 90, seed=1)
    q[30:45, 3 if finger.name == "thumb" else 2] = 0.0
    q[45:60] = np.where(np.random.default_rng(2).random((15, 4)) < 0.5, q[45:60], finger.lower)
    points = finger.fk(q).position
    points[60:] = np.random.default_rng(3).uniform(-0.15, 0.2, (30, 3))
    for given_ in asked(finger, q, seed=4):
        batch = solve(finger, points, given_)
        best, near = batch.best(), batch.best(near=q)
        for row, point in enumerate(points):
            one = solve(finger, point, {name: value[row] for name, value in given_.items()})
            agree(one, batch, row)
            for ours, theirs in ((one.best(), best), (one.best(near=q[row]), near)):
                for value, wanted in zip(ours, theirs, strict=True):
                    np.testing.assert_allclose(np.float64(value), wanted[row], rtol=0, atol=SAME)


@pytest.mark.parametrize("key", EVERY, ids=str)
def test_the_nearest_point_of_one_target_is_that_of_a_batch(key: Key) -> None:
    finger = FINGERS[key]
    points = np.random.default_rng(5).uniform(-0.25, 0.25, (20, 3))
    for given_ in asked(finger, postures(finger, 20, seed=6), seed=7):
        for limits in (True, False):
            batch = solve(finger, points, given_).nearest(limits=limits)
            for row, point in enumerate(points):
                one = solve(finger, point, {name: value[row] for name, value in given_.items()}).nearest(limits=limits)
                for value, wanted in zip(one, batch, strict=True):
                    np.testing.assert_allclose(value, wanted[row], rtol=0, atol=SAME)


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(EVERY), st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4), st.floats(0.0, 0.2))
def test_a_posture_inside_the_limits_is_found_again_in_every_mode(key: Key, parts: list[float], margin: float) -> None:
    """Wherever it lies, at limits, straight or on an axis, where its tip is reached exactly."""
    finger = FINGERS[key]
    low, high = finger.lower + margin, finger.upper - margin
    q = low + np.array(parts) * (high - low)
    pose = finger.fk(q)
    for given_ in [*held(finger, q), {"quaternion": pose.quaternion}, {"euler": pose.euler}, {"near": q}, {}]:
        solutions = solve(finger, pose.position, given_, margin=margin)
        assert solutions.reachable, given_.keys()
        for found in solutions.position[solutions.within]:
            assert np.linalg.norm(finger.fk(found).position - pose.position) <= 1e-12, given_.keys()
            assert (found >= low - 1e-8).all(), given_.keys()
            assert (found <= high + 1e-8).all(), given_.keys()
        if "near" in given_:
            np.testing.assert_allclose(solutions.position[0], q, rtol=0, atol=1e-6)
        if given_.keys() & {"rotation", "quaternion", "euler"}:
            assert solutions.best(near=q).angle <= 1e-6


@pytest.mark.parametrize("key", EVERY, ids=str)
def test_no_targets_have_no_solutions_and_the_shapes_of_many(key: Key) -> None:
    finger = FINGERS[key]
    for shape in ((0,), (3, 0)):
        q = np.zeros((*shape, 4))
        for given_ in [*held(finger, q), {"quaternion": np.ones((*shape, 4))}, {"near": q}, {}]:
            solutions = solve(finger, np.zeros((*shape, 3)), given_)
            k = 4 if given_.keys() - {"near"} else 1
            assert solutions.position.shape == (*shape, k, 4)
            assert solutions.within.shape == solutions.angle.shape == (*shape, k)
            assert solutions.nearest().posture.shape == solutions.best(near=q).posture.shape == (*shape, 4)
            assert solutions.best().reached.shape == shape


@pytest.mark.parametrize("bad", [nan, inf, -inf])
@pytest.mark.parametrize("key", EVERY, ids=str)
def test_what_is_not_finite_is_refused_for_one_target_as_for_many(key: Key, bad: float) -> None:
    finger = FINGERS[key]
    q = postures(finger, 3, seed=8)
    pose = finger.fk(q)
    for given_ in [*held(finger, q), {"quaternion": pose.quaternion}, {"euler": pose.euler}, {"near": q}, {}]:
        for name, value in {"position": pose.position, **given_}.items():
            spoilt = {
                "position": pose.position,
                **given_,
                name: np.where(np.arange(value.size) == 0, bad, value.ravel()),
            }
            spoilt[name] = spoilt[name].reshape(value.shape)
            for rows in (slice(None), 0):
                arguments = {key: array[rows] for key, array in spoilt.items()}
                with pytest.raises(ConfigError, match=f"{name} must be finite; 1 of its values are not"):
                    solve(finger, arguments.pop("position"), arguments)


@pytest.mark.parametrize("bad", [nan, inf, -inf])
@pytest.mark.parametrize("key", EVERY, ids=str)
def test_a_scalar_solve_refuses_what_is_not_finite(key: Key, bad: float) -> None:
    finger, scalar = FINGERS[key], FINGERS[key].scalar
    q = postures(finger, 1, seed=9)[0]
    point = finger.fk(q).position.tolist()
    ways = [scalar.at_q0, scalar.at_q1, scalar.at_psi] if finger.name == "thumb" else [scalar.at_pitch]
    for way in ways:
        for place, name in enumerate(("x", "y", "z", "the angle")):
            numbers = [*point, 0.7]
            numbers[place] = bad
            with pytest.raises(ConfigError, match=f"{name} must be finite; it is {bad}"):
                way(*numbers)


def test_one_target_may_be_given_in_any_way_that_numbers_can_be() -> None:
    finger = FINGERS["right", "index"]
    q = postures(finger, 1, seed=10)[0]
    point, pitch = finger.fk(q).position, q[1:].sum()
    expected = finger.ik(point, pitch=pitch).position
    for given_ in (point.tolist(), tuple(point), point.astype(object), np.asfortranarray(point)):
        np.testing.assert_array_equal(finger.ik(given_, pitch=float(pitch)).position, expected)
    for angle in (np.float64(pitch), np.array(pitch)):
        np.testing.assert_array_equal(finger.ik(point, pitch=angle).position, expected)
    assert finger.ik(point.tolist(), pitch=1).position.shape == (4, 4)


def test_values_for_many_do_not_go_with_one_position() -> None:
    finger = FINGERS["right", "index"]
    with pytest.raises(ConfigError, match=r"pitch \(2,\) does not go with positions \(3,\)"):
        finger.ik(np.zeros(3), pitch=[0.1, 0.2])
