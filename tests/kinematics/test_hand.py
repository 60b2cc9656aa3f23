"""One way to ask for the kinematics of any hand: closed forms where there are some, iteration elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics import FingerKinematics, hand_kinematics
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.kinematics.numeric import NumericFinger
from allegro_twin.types import Array

HANDS = [("allegro", "index"), ("allegro", "thumb"), ("leap", "middle"), ("model_o", "thumb")]


def postures(finger: FingerKinematics, n: int) -> Array:
    span = finger.upper - finger.lower
    return finger.lower + span * np.random.default_rng(0).uniform(0.2, 0.8, (n, len(span)))


@pytest.mark.parametrize(("model", "kind"), [("allegro", ClosedFormFinger), ("leap", NumericFinger)])
def test_a_finger_is_solved_in_closed_form_where_there_is_one_and_by_iteration_elsewhere(
    model: str, kind: type[object]
) -> None:
    hand = hand_kinematics(load_spec(model))
    assert all(isinstance(hand.finger(finger.name), kind) for finger in hand.spec.fingers)
    assert hand.finger("index") is hand.finger("index")
    with pytest.raises(ConfigError, match="no finger named 'indx'; did you mean 'index'"):
        hand.finger("indx")


@pytest.mark.parametrize(("model", "name"), HANDS)
def test_every_kind_of_finger_answers_one_target_and_many_alike(model: str, name: str) -> None:
    finger = hand_kinematics(load_spec(model)).finger(name)
    q = postures(finger, 5)
    targets = finger.fk(q).position
    many = finger.ik(targets, near=q)
    best = many.best(q)
    assert best.reached.all()
    np.testing.assert_allclose(finger.fk(best.posture).position, targets, atol=1e-4)
    for row, target in enumerate(targets):
        one = finger.ik(target, near=q[row])
        np.testing.assert_allclose(one.position, many.position[row], atol=1e-9)
        np.testing.assert_allclose(finger.fk(q[row]).rotation, finger.fk(q).rotation[row], atol=1e-12)


@pytest.mark.parametrize(("model", "name"), HANDS)
def test_every_kind_of_finger_says_how_near_it_comes_to_a_point_out_of_reach(model: str, name: str) -> None:
    finger = hand_kinematics(load_spec(model)).finger(name)
    far = np.array([[0.3, 0.0, 0.3], [-0.4, 0.1, 0.0]])
    solutions = finger.ik(far)
    nearest, best = solutions.nearest(), solutions.best()
    assert not solutions.reachable.any()
    assert np.isnan(solutions.position).all()
    np.testing.assert_array_equal(best.posture, nearest.posture)
    np.testing.assert_allclose(finger.fk(nearest.posture).position, nearest.point, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(nearest.point - far, axis=1), nearest.distance, atol=1e-9)
    one = finger.ik(far[0]).nearest()
    np.testing.assert_allclose(one.posture, nearest.posture[0], atol=1e-9)


@pytest.mark.parametrize(("model", "name"), HANDS)
def test_every_kind_of_finger_keeps_a_margin_to_its_limits(model: str, name: str) -> None:
    finger = hand_kinematics(load_spec(model)).finger(name)
    targets = finger.fk(postures(finger, 20)).position
    best = finger.ik(targets, margin=0.1).best()
    assert best.reached.any()
    assert (best.posture >= finger.lower + 0.1 - 1e-9).all()
    assert (best.posture <= finger.upper - 0.1 + 1e-9).all()
    with pytest.raises(ConfigError, match="margin 9.0 rad does not fit"):
        finger.ik(targets, margin=9.0)


def test_an_iteration_says_what_it_does_not_solve_for() -> None:
    finger = hand_kinematics(load_spec("leap")).finger("index")
    with pytest.raises(ConfigError, match="index of leap_right has no closed form: leave out pitch"):
        finger.ik([0.05, 0.04, 0.1], pitch=np.array(1.0))
    with pytest.raises(ConfigError, match="rotation and euler both say an orientation"):
        finger.ik([0.05, 0.04, 0.1], rotation=np.eye(3), euler=np.zeros(3))
    with pytest.raises(ConfigError, match="near .* does not go with positions"):
        finger.ik(np.zeros((3, 3)), near=np.zeros((2, 4)))


@pytest.mark.parametrize("model", ["allegro", "leap", "model_o", "qb_softhand"])
def test_fingertips_of_many_postures_are_those_of_each(model: str) -> None:
    hand = hand_kinematics(load_spec(model))
    q = np.random.default_rng(0).uniform(hand.spec.lower, hand.spec.upper, (3, hand.spec.n_joints))
    tips = hand.batch_fingertips()(q)
    for row, posture in enumerate(q):
        own = [pose.position for pose in hand.fingertips(posture).values()]
        np.testing.assert_allclose(tips[row], own, atol=1e-15)
