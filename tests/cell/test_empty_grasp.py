"""A close on nothing, foreseen: where it ends, and which fingers meet."""

from __future__ import annotations

import numpy as np

from allegro_twin.cell.motion.empty_grasp import empty_grasp, touching_joints
from allegro_twin.cell.planning.stored_grasps import stored_grasps
from allegro_twin.cell.settings import CellHandSettings
from allegro_twin.hands.library.grasps import Grasp

HAND = CellHandSettings()


def card_of(name: str) -> tuple[Grasp, np.ndarray]:
    card = next(card for card in stored_grasps("allegro") if card.name == name)
    return card.grasp, card.palm.rotation


def test_where_no_finger_meets_another_they_end_where_the_squeeze_wants_them() -> None:
    grasp, palm = card_of("orange")
    nothing = empty_grasp(HAND, grasp, palm)
    squeeze = grasp.squeeze
    assert nothing.telling.all()
    np.testing.assert_allclose(nothing.position, squeeze, atol=2.0 * 0.02 / 12.0)  # Dry friction over stiffness.


def test_motors_that_creep_are_waited_for() -> None:
    card = next(card for card in stored_grasps("model_o") if card.name == "lemon")
    nothing = empty_grasp(CellHandSettings(model="model_o"), card.grasp, card.palm.rotation)
    squeeze = card.grasp.squeeze
    np.testing.assert_allclose(
        nothing.position, squeeze, atol=0.025
    )  # Rad; its springs are stronger the more it closes.


def test_fingers_that_meet_are_known_beforehand() -> None:
    nothing = empty_grasp(HAND, *card_of("pear"))
    by_finger = nothing.telling.reshape(4, 4)
    assert by_finger.all(axis=1).tolist() == by_finger.any(axis=1).tolist() == [True, False, False, True]


def test_which_way_down_is_hardly_matters_for_a_hand_that_carries_itself() -> None:
    grasp, palm = card_of("orange")
    turned = palm @ np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    np.testing.assert_allclose(
        empty_grasp(HAND, grasp, palm).position, empty_grasp(HAND, grasp, turned).position, atol=2e-3
    )


def test_fingers_that_touch_each_other_are_known_by_their_joints() -> None:
    together = touching_joints(HAND, empty_grasp(HAND, *card_of("tuna_fish_can")).position).reshape(4, 4)
    assert together.all(axis=1).tolist() == together.any(axis=1).tolist() == [False, True, True, False]
    assert not touching_joints(HAND, empty_grasp(HAND, *card_of("orange")).position).any()
