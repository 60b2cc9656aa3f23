"""How a host deals with a hand unless somebody says otherwise, and the times that no hand can keep."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from allegro_twin.drivers.base.host_settings import SerialHostSettings as OnALine
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings as OnABus
from allegro_twin.drivers.dynamixel.driver.host_settings import ServoHostSettings as OfServos
from allegro_twin.drivers.polled.host_settings import PolledHostSettings as Polled
from allegro_twin.errors import ConfigError

ON_A_BUS = {
    "period": 0.003, "timeout": 0.05, "deadman": 0.3, "keeper": True, "velocity_cutoff": 30.0, "identify": True,
    "gravity": None, "temperature_period": 0.5, "imu_period": 0.0, "status_period": 1.0,
}  # fmt: skip


def given(kind: Any, **more: Any) -> dict[str, Any]:
    return dataclasses.asdict(kind(**more))


def test_a_host_on_a_bus_has_the_times_of_docs_safety() -> None:
    assert given(OnABus) == ON_A_BUS


@pytest.mark.parametrize("period", [0.0005, 0.0, 0.256, 0.0035, -0.003])
def test_a_hand_counts_whole_milliseconds(period: float) -> None:
    with pytest.raises(
        ConfigError, match=rf"period {period:g} s: a hand counts whole milliseconds, from 0.001 to 0.255"
    ):
        OnABus(period=period, timeout=9.0)
    assert OnABus(period=0.255, timeout=0.51).period == 0.255
    assert OnABus(period=0.001).period == 0.001


def test_silence_is_two_periods_at_least() -> None:
    assert OnABus(period=0.01, timeout=0.02).timeout == 0.02
    with pytest.raises(ConfigError, match="timeout 0.019 s must be two periods of 0.01 s or more"):
        OnABus(period=0.01, timeout=0.019)


def test_a_host_on_a_serial_line_asks_three_times_and_its_hand_waits_a_fifth_of_a_second() -> None:
    plain = {"period": 0.01, "watchdog": 0.2, "tries": 3, "keeper": True}
    assert given(OfServos) == plain | {"temperature_period": 4.0, "return_delay": 0}
    assert {name: value for name, value in given(Polled).items() if name != "latency"} == plain
    assert (OfServos.LONGEST, Polled.LONGEST) == (127, 250)
    assert issubclass(OfServos, OnALine)


@pytest.mark.parametrize(("watchdog", "counts"), [(0.02, 1), (0.0201, 2), (0.2, 10), (0.21, 11), (2.54, 127)])
def test_a_watchdog_counts_in_fiftieths_of_a_second_rounded_up(watchdog: float, counts: int) -> None:
    assert OfServos(period=0.005, watchdog=watchdog).watchdog_counts == counts


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"period": 0.0}, "period must be a number of seconds above 0, not 0.0"),
        ({"period": float("inf")}, "period must be a number of seconds above 0, not inf"),
        ({"period": float("nan")}, "period must be a number of seconds above 0, not nan"),
        ({"watchdog": 0.0}, r"watchdog 0 s must be from 0.02 to 2.54 s, and two periods of 0.01 s or more"),
        ({"watchdog": 2.55}, r"watchdog 2.55 s must be from 0.02 to 2.54 s"),
        ({"watchdog": 0.199, "period": 0.1}, r"two periods of 0.1 s or more"),
        ({"tries": 0}, "tries must be 1 or more, not 0"),
        ({"return_delay": 255}, "return_delay must be 0 to 254, not 255"),
        ({"return_delay": -1}, "return_delay must be 0 to 254, not -1"),
    ],
)
def test_times_that_no_servo_can_keep_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        OfServos(**change)


def test_what_is_just_possible_is_taken() -> None:
    assert OfServos(period=0.1, watchdog=0.2, tries=1, return_delay=254).tries == 1
    assert Polled(period=0.01, watchdog=5.0).watchdog_counts == 250
    with pytest.raises(ConfigError, match="from 0.02 to 5 s"):
        Polled(period=0.01, watchdog=5.01)
    for latency in (0.0, float("inf"), float("nan")):
        with pytest.raises(ConfigError, match="latency must be above 0 s, not"):
            Polled(latency=latency)


@pytest.mark.parametrize(("questions", "periods"), [(1, 400), (16, 25), (17, 23), (1000, 1)])
def test_every_servo_is_asked_for_its_temperature_once_in_four_seconds(questions: int, periods: int) -> None:
    assert OfServos().every(questions) == periods
