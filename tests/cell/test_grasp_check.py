"""The checks of a grasp and their verdict: what can be weighed, what counts as pressing, and what confirms it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from allegro_twin.cell.checks.camera_check import CameraCheck
from allegro_twin.cell.checks.grasp_check import (
    GraspCheck,
    check_grasp,
    detectable_weight,
    grasp_verdict,
    may_weigh_more,
    presses_surely,
    pressing_torque,
    stopping_torque,
    tare_samples,
    torque_between_fingers,
    weigh,
)
from allegro_twin.cell.checks.sensor_zero_check import check_drift, check_plausibility
from allegro_twin.cell.motion.empty_grasp import EmptyGrasp, misread_positions
from allegro_twin.cell.settings import GraspCheckSettings
from allegro_twin.types import Array

DOWN = np.array([0.0, 0.0, -9.81])
AXES = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
SETTINGS = GraspCheckSettings()


def felt(kilograms: float, samples: int, seed: int, bias: float = 0.0) -> list[Array]:
    """Of the hand, and of so much more, with the report's noise on each axis."""
    noise = np.random.default_rng(seed).normal(0.0, 1.3, (samples, 3))
    force = AXES.T @ (DOWN * kilograms)
    return [np.concatenate([force + each + bias, np.zeros(3)]) for each in noise]


def test_a_bias_of_the_sensor_is_no_weight() -> None:
    before, after = felt(0.0, 100, 1, bias=3.0), felt(0.5, 100, 2, bias=3.0)
    assert weigh(before, after, AXES) == pytest.approx(0.5, abs=0.06)


def test_more_samples_weigh_more_finely() -> None:
    def scatter(samples: int) -> float:
        pairs = [(felt(0.0, samples, 2 * k), felt(0.0, samples, 2 * k + 1)) for k in range(200)]
        return float(np.std([weigh(before, after, AXES) for before, after in pairs]))

    assert scatter(1) == pytest.approx(np.sqrt(2.0) * 1.3 / 9.81, rel=0.15)
    assert scatter(100) == pytest.approx(scatter(1) / 10.0, rel=0.2)


@pytest.mark.slow
def test_an_empty_hand_that_is_weighed_for_long_hardly_ever_weighs_what_can_be_told() -> None:
    before, after = SETTINGS.tare, SETTINGS.long
    told = detectable_weight(before, after, SETTINGS)
    assert detectable_weight(before, after - 1, SETTINGS) == SETTINGS.least
    assert told == pytest.approx(0.0162, abs=1e-4)
    pairs = [(felt(0.0, before, 2 * k), felt(0.0, after, 2 * k + 1)) for k in range(100)]
    assert np.mean([weigh(*pair, AXES) > told for pair in pairs]) < 0.02
    pairs = [(felt(0.0, before, 2 * k), felt(0.029, after, 2 * k + 1)) for k in range(100)]
    assert np.mean([weigh(*pair, AXES) > told for pair in pairs]) > 0.95


@pytest.mark.parametrize(("size", "samples"), [
    ((0.068, 0.054, 0.054), SETTINGS.tare),  # A lemon of 29 g.
    ((0.043, 0.043, 0.043), SETTINGS.tare),  # A golf ball of 46 g.
    ((0.067, 0.067, 0.102), SETTINGS.samples),  # A soup can of 349 g.
])  # fmt: skip
def test_before_a_small_object_is_taken_the_tare_is_longer(size: tuple[float, float, float], samples: int) -> None:
    assert tare_samples(np.array(size), SETTINGS) == samples


def test_friction_and_the_fingers_own_weight_are_no_grip() -> None:
    friction = np.full(4, 0.02)
    assert stopping_torque(
        np.array([0.04, -0.04, 0.1, 0.0]), np.array([0.0, 0.0, 0.06, 0.0]), friction
    ) == pytest.approx(0.0)
    assert stopping_torque(np.array([0.34, 0.0, 0.0, 0.0]), np.zeros(4), friction) == pytest.approx(0.3)


SINGLE = [[0], [1], [2], [3]]
NONE = np.zeros(4, bool)


def of(telling: list[int]) -> EmptyGrasp:
    """Four fingers of a joint each that would be at 0.5 rad around nothing."""
    return EmptyGrasp(np.full(4, 0.5), np.array(telling, bool))


ALL = of([1, 1, 1, 1])


def pressed(position: list[float], torque: list[float]) -> Array:
    return pressing_torque(np.array(position), np.array(torque), ALL, np.full(4, 12.0), np.full(4, 0.02))


def test_fingers_that_end_where_they_would_around_nothing_hold_nothing() -> None:
    np.testing.assert_array_equal(pressed([0.503] * 4, [0.036] * 4), 0.0)
    np.testing.assert_allclose(pressed([0.48, 0.5, 0.5, 0.49], [0.24, 0.0, 0.0, 0.12]), [0.2, 0.0, 0.0, 0.08])


def test_what_presses_is_never_more_than_the_motors_give() -> None:
    np.testing.assert_array_equal(pressed([-2.0] * 4, [0.0] * 4), 0.0)  # Without power.
    np.testing.assert_allclose(pressed([-2.0] * 4, [0.14] * 4), 0.1)
    np.testing.assert_array_equal(pressed([-2.0] * 4, [-0.7] * 4), 0.0)  # They are pulled away.
    np.testing.assert_allclose(pressed([0.48] * 4, [np.nan] * 4), 0.2)  # Nobody says what is given.


def test_fingers_that_meet_each_other_tell_nothing() -> None:
    assert torque_between_fingers(np.array([1.2, 0.0, 0.0, 0.0]), of([0, 1, 1, 1]), NONE) == 0.0
    assert torque_between_fingers(np.array([0.0, 1.2, 0.0, 0.0]), of([0, 1, 1, 1]), NONE) == 1.2


def test_fingers_that_hook_into_each_other_tell_nothing_while_another_can() -> None:
    press = np.array([1.2, 1.2, 0.0, 0.0])
    assert torque_between_fingers(press, ALL, np.array([True, True, False, False])) == 0.0
    assert torque_between_fingers(press, ALL, ~NONE) == pytest.approx(2.4)


def test_one_finger_may_be_stuck_and_two_may_press_on_each_other_where_one_is_misread() -> None:
    def sure(press: list[float], *meet: list[int]) -> bool:
        return presses_surely(np.tile(press, (len(meet), 1)), ALL, np.array(meet, bool), SINGLE, 0.1)

    assert sure([0.3, 0.3, 0.0, 0.0], [0, 0, 0, 0])
    assert not sure([0.6, 0.0, 0.0, 0.0], [0, 0, 0, 0])
    assert not sure([0.3, 0.3, 0.0, 0.0], [0, 0, 0, 0], [1, 1, 0, 0])
    assert sure([0.3, 0.3, 0.3, 0.0], [1, 1, 0, 0], [0, 1, 1, 0])


def test_a_motor_at_its_own_stop_that_is_read_a_little_short_of_it_presses_on_nothing_for_sure() -> None:
    """A hand of one motor that moves two fingers, 60 N·m/rad: 1° short of where it would be around nothing."""
    alone, way = EmptyGrasp(np.array([0.5]), np.ones(1, bool)), np.zeros((2, 1), bool)
    for short, sure in ((np.radians(1.0), False), (0.1, True)):
        off = misread_positions(np.array([0.5 - short]))
        press = pressing_torque(off, np.array([1.0]), alone, np.array([60.0]), np.zeros(1))
        assert presses_surely(press, alone, way, [[0], [0]], 0.1) == sure


@pytest.mark.parametrize(("by", "held"), [("force", False), ("torque", True), ("fingers", False)])
def test_the_settings_say_which_check_decides(by: str, held: bool) -> None:
    settings = GraspCheckSettings.model_validate({"by": by})
    found = check_grasp(0.03, 0.053, 1.0, 0.0, CameraCheck(), settings)
    assert (found.by_force, found.by_torque, found.by_fingers, found.held) == (None, True, False, held)


SEEN, HIDDEN, TABLE, FROZEN = (
    CameraCheck(there=True),
    CameraCheck(gone=True),
    CameraCheck(left="the camera sees it"),
    CameraCheck(fresh=False),
)
PARTLY = CameraCheck(left="the camera sees it", incomplete=True)
"""Something stands there, and some of the place is empty."""
BEHIND = CameraCheck(gone=True, behind="a part stayed behind")


@pytest.mark.parametrize("by", ["fingers", "torque", "force"])
@pytest.mark.parametrize("weight", [0.0, 0.3])
@pytest.mark.parametrize("torque", [0.0, 1.0])
@pytest.mark.parametrize("press", [0.0, 1.0])
@pytest.mark.parametrize("sure", [False, True])
@pytest.mark.parametrize("sight", [SEEN, HIDDEN, TABLE, FROZEN])
def test_checks_that_disagree_and_checks_that_nothing_confirms_are_never_held(
    by: str, weight: float, torque: float, press: float, sure: bool, sight: CameraCheck
) -> None:
    settings = GraspCheckSettings.model_validate({"by": by})
    found = check_grasp(weight, 0.053, torque, press, sight, settings)
    said = grasp_verdict(1.0, found, sight, lambda: sure, settings)
    confirmed = weight > 0.0 or sight is SEEN or (sure and sight is HIDDEN)
    held = torque > 0.0 and press > 0.0 and sight is not TABLE and confirmed and (by != "force" or weight > 0.0)
    assert (said.held is True) == held
    if said.fault is not None:
        assert said.fault.reason in ("checks disagree", "not confirmed")
        assert said.fault.sentence


@pytest.mark.parametrize(
    ("weight", "sight", "loaded"),
    [
        (0.3, CameraCheck(), True),
        (0.0, SEEN, True),
        (0.0, HIDDEN, True),
        (0.0, CameraCheck(), False),
        (0.3, TABLE, False),
        (0.3, PARTLY, False),
    ],
)
def test_a_miss_with_weight_a_sight_of_it_or_an_empty_place_may_be_in_the_hand_unless_it_is_seen_on_the_table(
    weight: float, sight: CameraCheck, loaded: bool
) -> None:
    found = check_grasp(weight, 0.053, 1.0, 0.0, sight, SETTINGS)
    said = grasp_verdict(1.0, found, sight, lambda: False, SETTINGS)
    assert (said.held, said.loaded) == (False, loaded)


@pytest.mark.parametrize(
    ("weight", "press", "sight", "loaded"),
    [
        (0.3, 1.0, TABLE, True),  # Weight, torque and fingers against the camera.
        (0.3, 0.09, TABLE, True),  # The fingers cannot tell.
        (0.02, 1.0, PARTLY, True),  # A light part.
        (0.02, 0.09, PARTLY, False),
        (0.02, 1.0, TABLE, False),  # Fingers that hook into each other: the whole of it stands there.
        (0.3, 0.0, PARTLY, False),  # A biased sensor and an empty hand.
    ],
)
def test_what_force_torque_or_fingers_feel_is_put_back_though_the_camera_sees_something_on_the_table(
    weight: float, press: float, sight: CameraCheck, loaded: bool
) -> None:
    found = check_grasp(weight, 0.053, 1.0, press, sight, SETTINGS)
    said = grasp_verdict(1.0, found, sight, lambda: True, SETTINGS)
    assert (said.held, said.loaded) == (False, loaded)


@pytest.mark.parametrize(
    ("weight", "torque", "press", "warning", "held"),
    [
        (0.3, 1.0, 1.0, "", True),
        (0.3, 1.0, 1.0, "its zero moved", False),
        (0.02, 1.0, 1.0, "", False),
        (0.3, 1.0, 0.0, "", False),
        (0.3, 0.0, 1.0, "", False),
    ],
)
def test_a_part_is_held_where_weight_torque_and_fingers_agree_and_the_verdict_says_what_stayed_behind(
    weight: float, torque: float, press: float, warning: str, held: bool
) -> None:
    found = replace(check_grasp(weight, 0.053, torque, press, BEHIND, SETTINGS), warning=warning)
    said = grasp_verdict(1.0, found, BEHIND, lambda: True, SETTINGS)
    assert (said.held is True, said.warning == "a part stayed behind") == (held, held)
    if not held:
        assert said.loaded or said.fault is not None  # The hand does not open in the air.


def test_a_hand_that_presses_on_something_that_nothing_confirms_says_what_is_missing() -> None:
    said = grasp_verdict(1.0, check_grasp(0.02, 0.053, 1.0, 0.9, FROZEN, SETTINGS), FROZEN, lambda: True, SETTINGS)
    assert said.fault is not None
    assert "weighs 20 g of the 53 g that can be told, and the camera is frozen" in said.fault.sentence


def test_a_zero_that_moves_while_nothing_touches_the_hand_is_told() -> None:
    assert check_drift(felt(0.0, 40, 1), felt(0.0, 100, 2), SETTINGS) == ""
    assert "its zero moved by" in check_drift(felt(0.0, 40, 1), felt(0.0, 100, 2, bias=2.0), SETTINGS)
    assert check_drift([], felt(0.0, 100, 2), SETTINGS) == ""


def empty(weight: float, press: float, by: str = "fingers") -> tuple[GraspCheck, GraspCheckSettings]:
    settings = GraspCheckSettings.model_validate({"by": by})
    return check_grasp(weight, 0.053, 0.0, press, CameraCheck(), settings), settings


@pytest.mark.parametrize(("weight", "press", "by", "why"), [
    (0.3, 1.0, "fingers", ""), (0.3, 1.0, "force", ""), (0.02, 1.0, "fingers", ""), (0.02, 0.0, "force", ""),
    (0.3, 0.0, "fingers", "would be around nothing"), (0.3, 0.0, "force", "would be around nothing"),
    (0.02, 1.0, "force", "something is between the fingers"), (2.0, 1.0, "fingers", "more than the arm carries"),
    (-0.2, 1.0, "fingers", "upwards"),
])  # fmt: skip
def test_a_weight_that_the_fingers_contradict_or_that_cannot_be_is_doubted(
    weight: float, press: float, by: str, why: str
) -> None:
    found, settings = empty(weight, press, by)
    said = check_plausibility(found, felt(0.0, 100, 1), felt(weight, 100, 2), AXES, settings)
    assert why in said
    assert bool(said) == bool(why)


def test_a_force_to_the_side_is_no_weight() -> None:
    aside = [each + AXES.T @ [0.0, 3.0, 0.0] @ np.eye(3, 6) for each in felt(0.3, 100, 2)]
    found, settings = empty(0.3, 1.0)
    assert "sideways" in check_plausibility(found, felt(0.0, 100, 1), aside, AXES, settings)


@pytest.mark.parametrize("by", ["fingers", "torque", "force"])
@pytest.mark.parametrize(("weight", "torque", "sight", "held"), [
    (0.057, 1.0, SEEN, True), (0.02, 1.0, SEEN, False), (0.057, 1.0, HIDDEN, False), (0.057, 1.0, FROZEN, False),
    (0.057, 0.0, SEEN, False), (0.057, 1.0, TABLE, False),
])  # fmt: skip
def test_what_fingers_cannot_tell_is_held_where_torque_weight_and_camera_all_say_so(
    by: str, weight: float, torque: float, sight: CameraCheck, held: bool
) -> None:
    """An apple in the hand of the LEAP demo: the fingers that do not touch each other press with 0.09 N·m."""
    settings = GraspCheckSettings.model_validate({"by": by})
    found = check_grasp(weight, 0.053, torque, 0.0912, sight, settings)
    assert found.by_fingers is None
    assert (grasp_verdict(1.0, found, sight, lambda: True, settings).held is True) == held


def test_a_doubted_weight_does_not_stand_in_for_fingers_that_cannot_tell() -> None:
    found = replace(check_grasp(0.3, 0.053, 1.0, 0.0912, SEEN, SETTINGS), warning="its zero moved")
    said = grasp_verdict(1.0, found, SEEN, lambda: True, SETTINGS)
    assert (said.held, said.loaded) == (False, True)
    assert "the fingers cannot tell whether it was: 0.09 N·m are between them" in said.warning


@pytest.mark.parametrize(("between", "weight", "sight", "held"), [
    (0.09, 0.3, CameraCheck(), True), (0.09, 0.02, SEEN, True), (0.09, 0.02, HIDDEN, None), (0.02, 0.3, SEEN, False),
])  # fmt: skip
def test_what_was_held_is_not_dropped_because_the_fingers_press_a_little_less(
    between: float, weight: float, sight: CameraCheck, held: bool | None
) -> None:
    found = check_grasp(weight, 0.053, 1.0, between, sight, SETTINGS)
    said = grasp_verdict(1.0, found, sight, lambda: False, SETTINGS, again=True)
    assert said.held is held
    assert (said.fault is not None and said.fault.reason == "not confirmed") == (held is None)


def test_what_the_camera_sees_and_the_fingers_cannot_tell_is_weighed_for_longer() -> None:
    light = check_grasp(0.03, 0.053, 1.0, 0.09, SEEN, SETTINGS)
    assert may_weigh_more(light, SEEN)
    assert not may_weigh_more(check_grasp(0.03, 0.053, 1.0, 0.02, SEEN, SETTINGS), SEEN)  # The fingers say no.
    assert not may_weigh_more(check_grasp(0.03, 0.053, 1.0, 0.09, HIDDEN, SETTINGS), HIDDEN)


@pytest.mark.parametrize(
    ("press", "sight", "doubted"), [(0.0, CameraCheck(), True), (0.0, SEEN, False), (0.09, HIDDEN, False)]
)
def test_a_weight_is_not_doubted_for_fingers_that_cannot_tell_or_for_fingers_alone(
    press: float, sight: CameraCheck, doubted: bool
) -> None:
    found = check_grasp(0.3, 0.053, 1.0, press, sight, SETTINGS)
    said = check_plausibility(found, felt(0.0, 100, 1), felt(0.3, 100, 2), AXES, SETTINGS)
    assert bool(said) == doubted
