"""One target at a time gives what a batch gives."""

from __future__ import annotations

from dataclasses import replace
from math import asin, dist, pi, sin

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.kinematics.closed_form.geometry import load_geometry
from allegro_twin.kinematics.closed_form.scalar import ScalarKinematics, Solve
from allegro_twin.spec import Side
from allegro_twin.types import Array
from tests.kinematics.hands import EVERY, FINGERS, SPECS, postures, solve

Key = tuple[Side, str]


@pytest.mark.parametrize("key", EVERY, ids=str)
def test_a_scalar_fingertip_is_the_batchs(key: Key) -> None:
    finger = FINGERS[key]
    q = postures(finger, 500)
    scalar = [finger.scalar.fk(*row) for row in q.tolist()]
    np.testing.assert_allclose(scalar, finger.fk(q).position, rtol=0, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("margin", [0.0, 0.1])
@pytest.mark.parametrize("key", EVERY, ids=str)
def test_a_scalar_solve_finds_the_branches_of_the_batch(key: Key, margin: float) -> None:
    """Points that are reached, and points anywhere, most of which are not."""
    finger, scalar = FINGERS[key], FINGERS[key].scalar
    q = postures(finger, 700, seed=1)
    points = finger.fk(q).position
    points[450:] = np.random.default_rng(2).uniform(-0.1, 0.15, (250, 3))
    thumb = finger.name == "thumb"
    held = {"q0": q[:, 0], "q1": q[:, 1], "psi": q[:, 2] + q[:, 3]} if thumb else {"pitch": q[:, 1:].sum(axis=1)}
    ways = {"pitch": scalar.at_pitch, "q0": scalar.at_q0, "q1": scalar.at_q1, "psi": scalar.at_psi}
    for name, values in held.items():
        for point, value in zip(points, values, strict=True):
            batch = solve(finger, point, {name: value}, margin)
            expected = batch.position[batch.within]
            found = np.array(ways[name](point[0], point[1], point[2], float(value), margin)).reshape(-1, 4)
            assert len(found) == len(expected)
            order = np.lexsort(np.round(found, 5).T), np.lexsort(np.round(expected, 5).T)
            np.testing.assert_allclose(found[order[0]], expected[order[1]], rtol=0, atol=1e-8)


@pytest.mark.long
@pytest.mark.parametrize("key", EVERY, ids=str)
def test_a_hundred_thousand_scalar_postures_are_found_again(key: Key) -> None:
    """Each to 1e-8 rad, and every branch that is given on its point to 1e-12 m."""
    finger, scalar = FINGERS[key], FINGERS[key].scalar
    q = postures(finger, 100_000, seed=3)
    rows, points = q.tolist(), finger.fk(q).position.tolist()
    ways: list[tuple[Solve, Array]] = [(scalar.at_pitch, q[:, 1:].sum(axis=1))]
    if finger.name == "thumb":
        ways = [(scalar.at_q0, q[:, 0]), (scalar.at_q1, q[:, 1]), (scalar.at_psi, q[:, 2] + q[:, 3])]
    for way, values in ways:
        for point, value, row in zip(points, values.tolist(), rows, strict=True):
            found = way(point[0], point[1], point[2], value)
            assert any(max(abs(a - b) for a, b in zip(one, row, strict=True)) <= 1e-8 for one in found), (row, found)
            assert all(dist(scalar.fk(*one), point) <= 1e-12 for one in found), row


@pytest.mark.parametrize("key", EVERY, ids=str)
def test_an_angle_may_be_given_full_turns_away(key: Key) -> None:
    finger, scalar = FINGERS[key], FINGERS[key].scalar
    for row in postures(finger, 50, seed=4).tolist():
        point, (q0, q1, q2, q3) = scalar.fk(*row), row
        ways = [(scalar.at_pitch, q1 + q2 + q3)]
        if finger.name == "thumb":
            ways = [(scalar.at_q0, q0), (scalar.at_q1, q1), (scalar.at_psi, q2 + q3)]
        for way, value in ways:
            turned = way(*point, value + 4 * pi)
            np.testing.assert_allclose(turned, way(*point, value), rtol=0, atol=1e-8)
            assert len(turned) > 0


@pytest.mark.parametrize("key", EVERY, ids=str)
def test_scalar_branches_stay_on_their_point_at_a_straight_elbow(key: Key) -> None:
    finger, scalar = FINGERS[key], FINGERS[key].scalar
    q = postures(finger, 500, seed=5)
    q[:, 3 if finger.name == "thumb" else 2] = 0.0
    for row in q.tolist():
        point = scalar.fk(*row)
        found = scalar.at_q0(*point, row[0]) if finger.name == "thumb" else scalar.at_pitch(*point, sum(row[1:]))
        assert min(max(abs(a - b) for a, b in zip(one, row, strict=True)) for one in found) <= 1e-6
        assert all(dist(scalar.fk(*one), point) <= 1e-12 for one in found)


@pytest.mark.parametrize("key", EVERY, ids=str)
def test_on_the_axis_of_a_joint_that_it_leaves_free_a_scalar_solve_leaves_it_at_zero(key: Key) -> None:
    """The abduction axis of a finger; on the thumb the axis of joint 1."""
    scalar = FINGERS[key].scalar
    if key[1] == "thumb":
        (link, tip), q2 = load_geometry("allegro", "thumb").links, -0.1
        q3 = asin(-link / tip * sin(q2)) - q2  # Both links end on the axis.
        found = [q for q1 in (0.3, 0.9) for q in scalar.at_q0(*scalar.fk(0.7, q1, q2, q3), 0.7)]
        free = 1
    else:
        first, second, tip = load_geometry("allegro", key[1]).links
        q1, q2 = -0.15, 0.1
        q3 = asin(-(first * sin(q1) + second * sin(q1 + q2)) / tip) - q1 - q2
        found = [q for q0 in (0.2, 0.4) for q in scalar.at_pitch(*scalar.fk(q0, q1, q2, q3), q1 + q2 + q3)]
        free = 0
    assert len(found) >= 2
    assert all(q[free] == 0.0 for q in found)


@pytest.mark.parametrize("limits", [(-1.2, 0.4), (0.3, 1.5), (-1.2, -0.4), (0.0, 1.5)], ids=str)
@pytest.mark.parametrize("name", ["index", "thumb"])
def test_an_elbow_with_other_limits_is_held_to_them(name: str, limits: tuple[float, float]) -> None:
    """On one side of straight, or with more room on the negative side."""
    spec = SPECS["right"]
    joint = spec.finger(name).joints[3 if name == "thumb" else 2]
    lower, upper = spec.lower.copy(), spec.upper.copy()
    lower[joint], upper[joint] = limits
    finger = ClosedFormFinger(replace(spec, lower=lower, upper=upper), name)
    q = np.concatenate([postures(finger, 300, seed=6), postures(FINGERS["right", name], 300, seed=7)])
    held = "q0" if name == "thumb" else "pitch"
    values = q[:, 0] if name == "thumb" else q[:, 1:].sum(axis=1)
    batch = solve(finger, finger.fk(q).position, {held: values})
    for k, point in enumerate(finger.fk(q).position.tolist()):
        found = getattr(finger.scalar, f"at_{held}")(*point, float(values[k]))
        expected = batch.position[k][batch.within[k]].tolist()
        assert len(found) == len(expected)
        np.testing.assert_allclose(sorted(found), sorted(map(tuple, expected)), rtol=0, atol=1e-8)
    assert batch.reachable[:300].all()
    assert not batch.reachable.all()


def test_joints_that_turn_too_far_for_the_scalar_forms_are_refused() -> None:
    finger, geometry = FINGERS["right", "thumb"], load_geometry("allegro", "thumb")
    wide, folding, turning = (finger.upper.copy() for _ in range(3))
    wide[0], folding[3], turning[2] = finger.lower[0] + pi, pi, 2.8
    for upper, message in ((wide, "less than half a turn"), (folding, "cannot fold"), (turning, "less than half a")):
        with pytest.raises(ConfigError, match=message):
            ScalarKinematics(geometry, finger.lower, upper, np.ones(4), left=False)
    with pytest.raises(ConfigError, match="only joint 0 of a finger may be mirrored"):
        ScalarKinematics(geometry, finger.lower, finger.upper, np.array([-1.0, 1, 1, 1]), left=False)


def test_a_scalar_target_out_of_reach_has_no_posture() -> None:
    assert FINGERS["right", "index"].scalar.at_pitch(0.0, 0.0, 0.5, 0.3) == []
    assert FINGERS["right", "thumb"].scalar.at_q0(0.0, 0.0, 0.5, 0.6) == []
    assert FINGERS["right", "thumb"].scalar.at_q1(0.5, 0.0, 0.0, 0.6) == []
    assert FINGERS["right", "thumb"].scalar.at_psi(0.0, 0.0, 0.5, 0.6) == []


def test_a_way_of_another_finger_is_refused() -> None:
    with pytest.raises(ConfigError, match="thumb has no pitch"):
        FINGERS["right", "thumb"].scalar.at_pitch(0.0, 0.0, 0.1, 0.3)
    with pytest.raises(ConfigError, match="use at_pitch"):
        FINGERS["right", "ring"].scalar.at_q0(0.0, 0.0, 0.1, 0.3)
