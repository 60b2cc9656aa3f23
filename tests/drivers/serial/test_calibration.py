"""Between a shaft and its actuator: id, direction, zero, gear, current."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from allegro_twin.drivers.dynamixel.codec.calibration import RAD_PER_TICK, Calibration, Mounting
from allegro_twin.drivers.dynamixel.codec.table import XC330_M288, XM430_W350
from allegro_twin.errors import ConfigError
from tests.drivers.serial.rigs import KT, LIMIT, calibrated, small_spec


def test_positions_come_back_within_half_a_tick() -> None:
    calibration = calibrated(5, gear=0.5)
    position = np.linspace(-1.5, 1.5, 5)
    back = calibration.position(np.array(calibration.ticks(position), dtype=np.float64))
    np.testing.assert_allclose(back, position, atol=0.25 * RAD_PER_TICK + 1e-12)


def test_direction_turns_position_velocity_and_torque_around() -> None:
    one = Calibration(XM430_W350, (Mounting(1, 1.0, zero=2048), Mounting(2, 1.0, zero=2048, direction=-1)))
    assert one.ticks(np.array([0.1, 0.1])) == [2113, 1983]
    np.testing.assert_allclose(one.velocity(np.array([10.0, 10.0])), [0.2398, -0.2398], atol=1e-4)
    torque = one.torque(np.array([100.0, 100.0]))
    np.testing.assert_allclose(torque, [0.269 * 4.1 / 2.3, -0.269 * 4.1 / 2.3])
    np.testing.assert_array_equal(one.torque_counts(torque), [100, 100])
    np.testing.assert_array_equal(one.velocity_counts(one.velocity(np.array([10.0, 10.0]))), [10, 10])


def test_a_gear_trades_way_for_effort() -> None:
    geared = calibrated(1, gear=0.25)
    assert geared.ticks(np.array([0.25 * np.pi])) == [2048 + 2048]
    plain = calibrated(1)
    np.testing.assert_allclose(
        geared.effort(np.array(geared.current_counts)), 4.0 * plain.effort(np.array(plain.current_counts))
    )


def test_an_effort_becomes_a_current_rounded_down_and_never_above_the_limit() -> None:
    calibration = calibrated(2)
    most = int(LIMIT / 2.69e-3)
    assert calibration.current_counts == (most, most)
    assert calibration.effort_counts(np.array([0.1, 100.0])) == [int(0.1 / (2.69e-3 * KT)), most]
    assert calibration.effort_counts(calibration.effort(np.array(calibration.current_counts))) == [most, most]


@pytest.mark.parametrize(
    ("wrong", "names"),
    [
        ({"id": 253}, "id must be from 0 to 252, not 253"),
        ({"current_limit": 0.0}, "current_limit must be above 0"),
        ({"current_limit": float("nan")}, "current_limit must be above 0"),
        ({"direction": 0}, "direction must be 1 or -1"),
        ({"gear": -1.0}, "gear must be above 0"),
        ({"zero": 1e9}, "zero must be within"),
        ({"torque_per_ampere": 0.0}, "torque_per_ampere must be above 0"),
    ],
)
def test_what_cannot_be_is_refused_by_name(wrong: dict[str, float], names: str) -> None:
    with pytest.raises(ConfigError, match=names):
        Mounting(**({"id": 1, "current_limit": 0.5} | wrong))  # type: ignore[arg-type]  # What is wrong is the point.


def test_a_current_that_the_model_does_not_have_is_refused_with_the_most_it_has() -> None:
    with pytest.raises(ConfigError, match=r"servo 1: current_limit is 4 A; a XM430-W350 can be given 3.209 A at most"):
        Calibration(XM430_W350, (Mounting(1, 4.0),))
    with pytest.raises(ConfigError, match="less than a count"):
        Calibration(XC330_M288, (Mounting(1, 0.0001),))


def test_an_id_that_is_there_twice_is_refused() -> None:
    with pytest.raises(ConfigError, match="two servos of this hand have the id 7"):
        Calibration(XM430_W350, (Mounting(7, 0.5), Mounting(7, 0.5)))


def test_the_servos_of_another_hand_are_refused() -> None:
    calibrated(4).check(small_spec(4))
    with pytest.raises(ConfigError, match="small_right has 5 actuators; 4 servos are described"):
        calibrated(4).check(small_spec(5))
    with pytest.raises(ConfigError, match="takes a limited_position; small_right takes torque"):
        calibrated(4).check(replace(small_spec(4), commands=("torque",)))


def test_a_current_limit_of_the_highest_count_is_taken_and_one_that_rounds_above_it_refused() -> None:
    highest = XM430_W350.named["current_limit"].high * XM430_W350.current_unit
    for above, taken in ((0.0, True), (0.4, True), (0.6, False), (1.0, False)):
        limit = highest + above * XM430_W350.current_unit
        if taken:
            assert calibrated(current_limit=limit).current_counts == (1193,) * 4
        else:
            with pytest.raises(ConfigError, match=r"a XM430-W350 can be given 3\.209 A at most"):
                calibrated(current_limit=limit)
    with pytest.raises(ConfigError, match="is less than a count"):
        calibrated(current_limit=0.4 * XM430_W350.current_unit)
