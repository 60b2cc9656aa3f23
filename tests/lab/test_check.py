"""The two checks: what 100 samples can weigh, a bias that the tare takes away, and what counts as pressing."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.lab.check import Checked, checked, kept_apart, stopped, weighed
from allegro_twin.lab.doubt import doubted, drifted
from allegro_twin.lab.nothing import Nothing
from allegro_twin.lab.settings import ValidateSettings
from allegro_twin.types import Array

DOWN = np.array([0.0, 0.0, -9.81])
AXES = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
SETTINGS = ValidateSettings()


def felt(kilograms: float, samples: int, seed: int, bias: float = 0.0) -> list[Array]:
    """Of the hand, and of so much more, with the report's noise on each axis."""
    noise = np.random.default_rng(seed).normal(0.0, 1.3, (samples, 3))
    force = AXES.T @ (DOWN * kilograms)
    return [np.concatenate([force + each + bias, np.zeros(3)]) for each in noise]


def test_a_bias_of_the_sensor_is_no_weight() -> None:
    before, after = felt(0.0, 100, 1, bias=3.0), felt(0.5, 100, 2, bias=3.0)
    assert weighed(before, after, AXES) == pytest.approx(0.5, abs=0.06)


def test_more_samples_weigh_more_finely() -> None:
    def scatter(samples: int) -> float:
        pairs = [(felt(0.0, samples, 2 * k), felt(0.0, samples, 2 * k + 1)) for k in range(200)]
        return float(np.std([weighed(before, after, AXES) for before, after in pairs]))

    assert scatter(1) == pytest.approx(np.sqrt(2.0) * 1.3 / 9.81, rel=0.15)
    assert scatter(100) == pytest.approx(scatter(1) / 10.0, rel=0.2)


def test_friction_and_the_fingers_own_weight_are_no_grip() -> None:
    friction = np.full(4, 0.02)
    assert stopped(np.array([0.04, -0.04, 0.1, 0.0]), np.array([0.0, 0.0, 0.06, 0.0]), friction) == pytest.approx(0.0)
    assert stopped(np.array([0.34, 0.0, 0.0, 0.0]), np.zeros(4), friction) == pytest.approx(0.3)


def test_fingers_that_end_where_they_would_around_nothing_hold_nothing() -> None:
    end, stiffness, friction = np.full(4, 0.5), np.full(4, 12.0), np.full(4, 0.02)
    nothing = Nothing(end, np.ones(4, bool))
    off, none = end - [0.02, 0.0, 0.0, 0.01], np.zeros(4, bool)
    assert kept_apart(end + 0.003, nothing, stiffness, friction, none) == pytest.approx(0.0)
    assert kept_apart(off, nothing, stiffness, friction, none) == pytest.approx(0.2 + 0.08)


def test_fingers_that_meet_each_other_tell_nothing() -> None:
    stiffness, friction, none = np.full(2, 12.0), np.zeros(2), np.zeros(2, bool)
    nothing = Nothing(np.zeros(2), np.array([False, True]))
    assert kept_apart(np.array([0.1, 0.0]), nothing, stiffness, friction, none) == 0.0
    assert kept_apart(np.array([0.1, 0.1]), nothing, stiffness, friction, none) == pytest.approx(1.2)


def test_fingers_that_hook_into_each_other_tell_nothing_while_another_can() -> None:
    stiffness, friction = np.full(3, 12.0), np.zeros(3)
    nothing, off = Nothing(np.zeros(3), np.ones(3, bool)), np.array([0.1, 0.1, 0.0])
    assert kept_apart(off, nothing, stiffness, friction, np.array([True, True, False])) == 0.0
    assert kept_apart(off, nothing, stiffness, friction, np.ones(3, bool)) == pytest.approx(2.4)


@pytest.mark.parametrize(("by", "held"), [("force", False), ("torque", True), ("fingers", False)])
def test_the_settings_say_which_check_decides(by: str, held: bool) -> None:
    settings = ValidateSettings.model_validate({"by": by})
    found = checked(0.03, 1.0, 0.1, settings)
    assert (found.by_force, found.by_torque, found.by_fingers, found.held) == (False, True, False, held)


def test_a_zero_that_moves_while_nothing_touches_the_hand_is_told() -> None:
    assert drifted(felt(0.0, 40, 1), felt(0.0, 100, 2), SETTINGS) == ""
    assert "its zero moved by" in drifted(felt(0.0, 40, 1), felt(0.0, 100, 2, bias=2.0), SETTINGS)
    assert drifted([], felt(0.0, 100, 2), SETTINGS) == ""


def empty(weight: float, between: float, by: str = "fingers") -> tuple[Checked, ValidateSettings]:
    settings = ValidateSettings.model_validate({"by": by})
    return checked(weight, 0.0, between, settings), settings


@pytest.mark.parametrize(("weight", "between", "by", "why"), [
    (0.3, 1.0, "fingers", ""), (0.3, 1.0, "force", ""), (0.02, 1.0, "fingers", ""), (0.02, 0.0, "force", ""),
    (0.3, 0.0, "fingers", "would be around nothing"), (0.3, 0.0, "force", "would be around nothing"),
    (0.02, 1.0, "force", "something is between the fingers"), (2.0, 1.0, "fingers", "more than the arm carries"),
    (-0.2, 1.0, "fingers", "upwards"),
])  # fmt: skip
def test_a_weight_that_the_fingers_contradict_or_that_cannot_be_is_doubted(
    weight: float, between: float, by: str, why: str
) -> None:
    found, settings = empty(weight, between, by)
    said = doubted(found, felt(0.0, 100, 1), felt(weight, 100, 2), AXES, settings)
    assert why in said
    assert bool(said) == bool(why)


def test_a_force_to_the_side_is_no_weight() -> None:
    aside = [each + AXES.T @ [0.0, 3.0, 0.0] @ np.eye(3, 6) for each in felt(0.3, 100, 2)]
    found, settings = empty(0.3, 1.0)
    assert "sideways" in doubted(found, felt(0.0, 100, 1), aside, AXES, settings)
