"""Commands and states are frozen, finite and of the right shape."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
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


@pytest.mark.parametrize("kind", [TorqueCommand, PositionCommand])
@pytest.mark.parametrize(
    ("values", "said"),
    [
        (np.full(16, 0.1 + 0.1j), "array of numbers, not of complex128"),
        (["0.1"] * 16, "array of numbers, not of <U3"),
        (np.array(["0.1"] * 16, dtype=object), "array of numbers, not of object"),
        ([None] * 16, "array of numbers, not of object"),
        ([True] * 16, "array of numbers, not of bool"),
        (np.ma.array(np.zeros(3), mask=[False, True, False]), "has masked values"),
    ],
)
def test_a_command_takes_no_text_no_complex_number_and_no_mask(kind: Any, values: Any, said: str) -> None:
    with pytest.raises(CommandError, match=said):
        kind(values)


def test_a_command_takes_any_row_of_real_numbers() -> None:
    for row in ([0.5, 1.0], (0.5, 1), np.array([0.5, 1.0], np.float32), np.ma.array([0.5, 1.0])):
        assert TorqueCommand(row).torque.tolist() == [0.5, 1.0]
        command = PositionCommand(row, effort=row, duration=0.5)
        assert command.effort is not None
        assert (command.effort.tolist(), command.duration) == ([0.5, 1.0], 0.5)
        assert replace(command, duration=1.0).position.tolist() == [0.5, 1.0]
    sent = pickle.loads(pickle.dumps(PositionCommand([1], duration=2.0)))
    assert (sent.position.tolist(), sent.effort, sent.duration) == ([1.0], None, 2.0)


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
