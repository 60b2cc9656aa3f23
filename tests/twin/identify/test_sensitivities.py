"""Answers to nudges: joint by joint the first time, all at once from then on."""

from __future__ import annotations

import numpy as np

from allegro_twin.twin.identify.fitting.shooting import Sensitivities
from allegro_twin.types import Array

FINGERS = [[0, 1, 2], [3, 4]]
"""A finger of three joints, and one of two."""


class Toy:
    """Residuals of one piece and moment that answer to joint j by `own[j]` at j and by CROSS at its finger's others."""

    CROSS = 0.3

    def __init__(self) -> None:
        self.own, self.plays = np.arange(1.0, 6.0), 0

    def nudged(self, joints: list[int]) -> Array:
        self.plays += 1
        found = np.zeros((1, 1, 5))
        for finger in FINGERS:
            for joint in (j for j in joints if j in finger):
                found[0, 0, finger] += np.where(np.array(finger) == joint, self.own[joint], self.CROSS)
        return found


def by_joint(answers: Sensitivities, toy: Toy) -> Array:
    """The answers of a joint's finger to it, (5, 5); 0 for those of the other finger."""
    found = np.zeros((5, 5))
    for place, answer in enumerate(answers.derivatives("damping", toy.nudged)):
        for finger in FINGERS:
            if place < len(finger):
                found[finger[place], finger] = answer[0, 0, finger]
    return found


def test_the_first_time_each_joint_of_a_finger_is_nudged_by_itself() -> None:
    toy = Toy()
    found = by_joint(Sensitivities(FINGERS), toy)
    assert toy.plays == 3
    np.testing.assert_allclose(np.diag(found), toy.own)
    assert found[0, 1] == Toy.CROSS
    assert found[3, 0] == 0.0


def test_then_one_play_tells_what_each_joint_answers_to_itself_and_the_others_answers_stay() -> None:
    toy, answers = Toy(), Sensitivities(FINGERS)
    first = by_joint(answers, toy)
    toy.own *= 2.0
    for plays in (4, 5):
        again = by_joint(answers, toy)
        assert toy.plays == plays
        np.testing.assert_allclose(np.diag(again), toy.own)
        np.testing.assert_allclose(again - np.diag(np.diag(again)), first - np.diag(np.diag(first)))
