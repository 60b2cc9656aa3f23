"""All fingertips at once are the fingertips of each finger."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.hands.description.hands import load_spec
from allegro_twin.kinematics.closed_form.finger import FingerKinematics
from allegro_twin.kinematics.closed_form.tips import Fingertips
from allegro_twin.kinematics.numeric_tips import ChainTips
from allegro_twin.sim.model.statics import hand_model, kinematic_tree
from allegro_twin.spec import Side


@pytest.mark.parametrize("side", ["right", "left"])
def test_all_fingertips_at_once_are_where_each_finger_says_its_own_is(side: Side) -> None:
    spec = load_spec(side=side)
    position = np.random.default_rng(0).uniform(spec.lower, spec.upper, (200, spec.n_joints))
    tips = Fingertips(spec)(position)
    for k, finger in enumerate(spec.fingers):
        own = FingerKinematics(spec, finger.name).tip(position[:, list(finger.joints)])
        np.testing.assert_allclose(tips[:, k], own, atol=1e-15, err_msg=finger.name)  # A rounding of 0.2 m is 3e-17.


def test_a_hand_s_fingertips_do_not_depend_on_how_many_hands_there_are() -> None:
    spec = load_spec(side="left")
    position = np.random.default_rng(1).uniform(spec.lower, spec.upper, (257, spec.n_joints))
    many, fingertips = Fingertips(spec)(position), Fingertips(spec)
    for row in (0, 1, 100, 256):
        np.testing.assert_array_equal(fingertips(position[row]), many[row])
        np.testing.assert_array_equal(fingertips(position[None, row])[0], many[row])


@pytest.mark.parametrize("hand", ["allegro", "leap", "model_o", "sih", "qb_softhand"])
def test_fingertips_of_any_chain_are_those_of_the_whole_model_alone_and_in_a_batch(hand: str) -> None:
    spec = load_spec(hand)
    tips, model = ChainTips(spec, kinematic_tree(spec)), hand_model(spec)
    position = np.random.default_rng(2).uniform(spec.lower, spec.upper, (30, spec.n_joints))
    many = tips(position)
    for row, posture in enumerate(position):
        own = np.array([pose.position for pose in model.fingertips(posture).values()])
        np.testing.assert_allclose(many[row], own, atol=1e-15)
        np.testing.assert_array_equal(tips(posture), many[row])
    assert np.ptp(many, axis=0).max() > 0.02, "no tip moved"
