"""What servos are told beside their goals, and how often."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from allegro_twin.drivers.dynamixel.codec.calibration import Calibration
from allegro_twin.drivers.dynamixel.driver.motors import ServoMotors
from allegro_twin.drivers.dynamixel.driver.sdk import Sdk


class Ear:
    """An SDK that writes down what it is to tell."""

    def __init__(self) -> None:
        self.told: list[tuple[int, str, list[int]]] = []
        self.period = 0

    def tell(self, ids: Sequence[int], name: str, values: Sequence[int]) -> None:
        self.told.append((self.period, name, list(values)))


class Counts:
    """A calibration of two servos whose current counts are mA."""

    ids = (1, 2)
    current_counts = (350, 350)

    def effort_counts(self, effort: np.ndarray[Any, Any]) -> list[int]:
        return [round(1000.0 * each) for each in effort]


def test_a_current_is_said_when_it_changes_and_again_every_tenth_period() -> None:
    """Nobody confirms it, so one that was lost on the line is said again."""
    ear = Ear()
    motors = ServoMotors(cast(Sdk, ear), cast(Calibration, Counts()), 5)
    for ear.period in range(25):
        motors.currents(np.array([0.1, 0.2]))
    motors.currents(None)
    said = [(period, values) for period, name, values in ear.told if name == "goal_current"]
    assert said == [(0, [100, 200]), (10, [100, 200]), (20, [100, 200]), (24, [350, 350])]
