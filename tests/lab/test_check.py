"""The two checks: what 100 samples can weigh, a bias that the tare takes away, and what counts as pressing."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.arm.tool import Bridge, weight
from allegro_twin.arm_spec import Load
from allegro_twin.lab.check import checked, stopped, weighed
from allegro_twin.lab.settings import ValidateSettings
from allegro_twin.types import Array, frozen

DOWN = np.array([0.0, 0.0, -9.81])
AXES = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
LOAD = Load(1.3, frozen([0.0, 0.0, 0.09]))


def felt(kilograms: float, samples: int, seed: int, bias: float = 0.0) -> list[Array]:
    """Of the hand, and of so much more, with the report's noise on each axis."""
    noise = np.random.default_rng(seed).normal(0.0, 1.3, (samples, 3))
    force = AXES.T @ (DOWN * kilograms)
    return [weight(LOAD, AXES, DOWN) + np.concatenate([force + each + bias, np.zeros(3)]) for each in noise]


def test_a_bias_of_the_sensor_is_no_weight() -> None:
    before, after = felt(0.0, 100, 1, bias=3.0), felt(0.5, 100, 2, bias=3.0)
    assert weighed(Bridge(LOAD), before, after, AXES, DOWN) == pytest.approx(0.5, abs=0.06)


def test_more_samples_weigh_more_finely() -> None:
    def scatter(samples: int) -> float:
        return float(np.std([weighed(Bridge(LOAD), felt(0.0, samples, 2 * k), felt(0.0, samples, 2 * k + 1), AXES, DOWN)
                             for k in range(200)]))  # fmt: skip

    assert scatter(1) == pytest.approx(np.sqrt(2.0) * 1.3 / 9.81, rel=0.15)
    assert scatter(100) == pytest.approx(scatter(1) / 10.0, rel=0.2)


def test_friction_and_the_fingers_own_weight_are_no_grip() -> None:
    friction = np.full(4, 0.02)
    assert stopped(np.array([0.04, -0.04, 0.1, 0.0]), np.array([0.0, 0.0, 0.06, 0.0]), friction) == pytest.approx(0.0)
    assert stopped(np.array([0.34, 0.0, 0.0, 0.0]), np.zeros(4), friction) == pytest.approx(0.3)


@pytest.mark.parametrize(("by", "held"), [("force", False), ("torque", True)])
def test_the_settings_say_which_check_decides(by: str, held: bool) -> None:
    settings = ValidateSettings.model_validate({"by": by})
    found = checked(0.03, 1.0, settings)
    assert (found.by_force, found.by_torque, found.held) == (False, True, held)
