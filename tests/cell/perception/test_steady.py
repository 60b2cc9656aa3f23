"""Targets are smoothed, jumps are left out, and the arm is let go only for what stands still."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.cell.perception.settings import SteadySettings
from allegro_twin.cell.perception.steady import TargetTrack, check_steadiness, track_target
from allegro_twin.cell.perception.target import GraspTarget

SETTINGS = SteadySettings(smooth=0.1, jump=0.05, patience=3, window=0.3, count=4, still=0.006)


def at(x: float, turn: float = 0.0) -> GraspTarget:
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return GraspTarget(np.array([x, 0.0, 0.2]), rotation, 0.05, 0.05)


def track(*places: float, step: float = 0.1, settings: SteadySettings = SETTINGS) -> TargetTrack:
    made = None
    for k, x in enumerate(places):
        made = track_target(made, at(x), step * k, settings)
    assert made is not None
    return made


def test_a_step_is_smoothed_with_the_time_constant() -> None:
    made = track_target(track(0.0), at(0.01), 0.1, SETTINGS)
    assert made.position[0] == pytest.approx(0.01 * (1.0 - np.exp(-1.0)))
    turned = track_target(track(0.0), at(0.0, 0.2), 0.1, SETTINGS)
    angle = 2.0 * np.arccos(turned.quaternion[0])
    assert angle == pytest.approx(0.2 * (1.0 - np.exp(-1.0)))
    assert track_target(track(0.0), at(0.01), 0.1, SETTINGS.model_copy(update={"smooth": 0.0})).position[0] == 0.01


def test_a_jump_is_left_out_and_stops_the_arm_until_it_is_over() -> None:
    made = track(0.0, 0.0, 0.0, 0.0, 0.2)
    assert made.position[0] == 0.0
    refused = check_steadiness(made, SETTINGS)
    assert refused is not None
    assert refused.reason == "jump"
    assert "0.200 m" in str(refused)
    over = track_target(made, at(0.0), 0.45, SETTINGS.model_copy(update={"window": 0.5}))
    assert over.jumped == ()
    assert check_steadiness(over, SETTINGS) is None


def test_a_turn_is_a_jump_too() -> None:
    made = track_target(track(0.0, 0.0), at(0.0, 1.0), 0.2, SETTINGS)
    assert len(made.jumped) == 1


def test_jumps_in_a_row_are_a_thing_that_was_moved() -> None:
    made = track(0.0, 0.0, 0.0, 0.2, 0.2, 0.2)
    assert made.position[0] == 0.2
    assert made.jumped == ()
    assert len(made.recent) == 1


def test_the_arm_may_go_for_enough_targets_that_are_near_each_other() -> None:
    few = check_steadiness(track(0.0, 0.0, step=0.05), SETTINGS)
    assert few is not None
    assert few.reason == "unsteady"
    assert check_steadiness(track(0.0, 0.001, 0.0, 0.001, 0.0, step=0.05), SETTINGS) is None
    moving = check_steadiness(track(0.0, 0.01, 0.02, 0.03, 0.04, step=0.05), SETTINGS)
    assert moving is not None
    assert "stand still" in str(moving)


def test_the_same_picture_twice_is_one_target() -> None:
    made = track(0.0, 0.0)
    assert track_target(made, at(0.01), 0.1, SETTINGS) is made
    assert track_target(made, at(0.01), 0.05, SETTINGS) is made


def test_what_is_older_than_the_window_is_forgotten() -> None:
    made = track(*[0.0] * 10)
    assert [round(seen.time, 3) for seen in made.recent] == [0.7, 0.8, 0.9]
