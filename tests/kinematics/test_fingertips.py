"""All fingertips at once are the fingertips of each finger."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.kinematics.fingertips import ChainFingertips, ClosedFormFingertips
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.tree import link_tree
from allegro_twin.spec import Side


@pytest.mark.parametrize("side", ["right", "left"])
def test_all_fingertips_at_once_are_where_each_finger_says_its_own_is(side: Side) -> None:
    spec = load_spec(side=side)
    position = np.random.default_rng(0).uniform(spec.lower, spec.upper, (200, spec.n_joints))
    tips = hand_kinematics(spec).batch_fingertips()(position)
    for k, finger in enumerate(spec.fingers):
        own = ClosedFormFinger(spec, finger.name).tip(position[:, list(finger.joints)])
        np.testing.assert_allclose(tips[:, k], own, atol=1e-15, err_msg=finger.name)  # A rounding of 0.2 m is 3e-17.


def test_a_hand_s_fingertips_do_not_depend_on_how_many_hands_there_are() -> None:
    spec = load_spec(side="left")
    position = np.random.default_rng(1).uniform(spec.lower, spec.upper, (257, spec.n_joints))
    fingertips = ClosedFormFingertips(spec)
    many = fingertips(position)
    for row in (0, 1, 100, 256):
        np.testing.assert_array_equal(fingertips(position[row]), many[row])
        np.testing.assert_array_equal(fingertips(position[None, row])[0], many[row])


@pytest.mark.parametrize("hand", ["allegro", "leap", "model_o", "sih", "qb_softhand"])
def test_fingertips_of_any_chain_are_those_of_the_whole_model_alone_and_in_a_batch(hand: str) -> None:
    spec = load_spec(hand)
    tips, model = ChainFingertips(spec, link_tree(spec)), hand_kinematics(spec)
    position = np.random.default_rng(2).uniform(spec.lower, spec.upper, (30, spec.n_joints))
    many = tips(position)
    for row, posture in enumerate(position):
        own = np.array([pose.position for pose in model.fingertips(posture).values()])
        np.testing.assert_allclose(many[row], own, atol=1e-15)
        np.testing.assert_array_equal(tips(posture), many[row])
    assert np.ptp(many, axis=0).max() > 0.02, "no tip moved"
