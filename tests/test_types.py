"""Commands and states are frozen, finite and of the right shape."""

from __future__ import annotations

import math
import pickle
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import CommandError
from allegro_twin.types import HandState, PositionCommand, TorqueCommand, frozen


@pytest.mark.parametrize("kind", [TorqueCommand, PositionCommand])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_command_cannot_hold_what_is_not_a_number(kind: Any, bad: float) -> None:
    values = np.zeros(16)
    values[3] = bad
    with pytest.raises(CommandError, match=r"\[3\] is .*must be finite"):
        kind(values)


def test_a_command_whose_sum_overflows_is_still_finite() -> None:
    assert TorqueCommand(np.full(16, 1e308)).torque[0] == 1e308


@pytest.mark.parametrize("values", [np.zeros((2, 16)), 1.0, "fast", [0.0, [1.0]]])
def test_a_command_has_one_axis_of_numbers(values: Any) -> None:
    with pytest.raises(CommandError, match=r"one axis|array of numbers"):
        TorqueCommand(values)


def test_a_command_keeps_its_own_copy() -> None:
    values = np.zeros(16)
    command = TorqueCommand(values)
    values[0] = 1.0
    assert command.torque[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        command.torque[0] = 1.0


def test_a_state_travels_between_processes() -> None:
    row = frozen(np.arange(16.0))
    state = HandState(0.3, 100, row, row, row, row, frozen([0, 0, -9.81]))
    other = pickle.loads(pickle.dumps(state))
    np.testing.assert_array_equal(other.position, row)
    assert other.tick == 100
