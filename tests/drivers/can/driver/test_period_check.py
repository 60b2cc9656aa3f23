"""A hand that keeps another period than it was told is found by its reports a second, and no late host makes one."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest

from allegro_twin.drivers.can.driver.clock import PeriodCheck, steady
from allegro_twin.errors import HandFault
from tests.drivers.can.driver.test_gaps import CHANNELS, Drive

PERIOD = 0.003


def states_until_found(check: PeriodCheck, stamps: list[float], *, excuses: int = 0, before: int = 0) -> int:
    """Whole hands until it is found, each a period, after so many; -1: never. `excuses`: a loss with every so many."""
    for k, t in enumerate(stamps, start=1):
        check.hear(t, before + k, k // excuses if excuses else 0)
        if not math.isnan(check.found):
            return k
    return -1


@pytest.mark.parametrize(("every", "within"), [(0.001, 260), (0.002, 130), (0.0024, 110)])
def test_a_hand_that_is_too_fast_is_found_within_a_quarter_of_a_second(every: float, within: int) -> None:
    check = PeriodCheck(PERIOD)
    assert 50 < states_until_found(check, [every * k for k in range(1000)]) <= within
    assert check.found == pytest.approx(every, rel=0.02)


@pytest.mark.parametrize("every", [0.004, 0.006, 0.010])
def test_a_hand_that_is_too_slow_is_found_within_two_seconds(every: float) -> None:
    check = PeriodCheck(PERIOD)
    assert 0 < states_until_found(check, [every * k for k in range(2000)]) * every < 2.0
    assert check.found == pytest.approx(every, rel=0.02)


@pytest.mark.parametrize("every", [0.002, 0.006])
def test_a_period_that_is_changed_in_mid_run_is_found_within_two_seconds(every: float) -> None:
    check = PeriodCheck(PERIOD)
    first = [PERIOD * k for k in range(2000)]
    assert states_until_found(check, first) == -1
    found = states_until_found(check, [first[-1] + every * k for k in range(1, 1000)], before=len(first))
    assert 0 < found * every < 2.0
    assert check.found == pytest.approx(every, rel=0.1)


@pytest.mark.parametrize("rate", [0.005, -0.005, 0.02, -0.02])
@pytest.mark.parametrize("seed", range(3))
def test_no_quartz_and_no_late_host_is_another_period(rate: float, seed: int) -> None:
    """Whole hands are read whenever the host wakes: after up to 20 ms, and now and then after up to half a second."""
    rng, now, stamps = random.Random(seed), 0.0, list[float]()
    for k in range(20_000):
        due = k * PERIOD * (1.0 + rate)
        if due > now:
            now = due + (rng.uniform(0.0, 0.5) if rng.random() < 0.02 else rng.uniform(0.0, 0.02))
        now += 1e-4
        stamps.append(max(now, due))
    assert states_until_found(PeriodCheck(PERIOD), stamps) == -1


def test_a_backlog_from_before_the_first_state_is_no_fast_hand() -> None:
    stalled = 0.5
    stamps = [max(PERIOD * k, stalled + 4e-4 * k) for k in range(2000)]
    assert states_until_found(PeriodCheck(PERIOD), stamps) == -1


def test_lost_periods_are_no_slow_hand() -> None:
    rng = random.Random(1)
    for loss in (0.2, 0.3, 0.45):
        assert states_until_found(PeriodCheck(PERIOD), [PERIOD * k for k in range(5000) if rng.random() > loss]) == -1
    assert states_until_found(PeriodCheck(PERIOD), [2 * PERIOD * k for k in range(5000)], excuses=10) == -1
    buffer = [0.031 * k + 1e-4 * j for k in range(500) for j in range(6)]  # It holds six whole hands; the rest is lost.
    assert states_until_found(PeriodCheck(PERIOD), buffer) == -1


def test_a_clock_that_is_set_back_begins_the_count_anew() -> None:
    check = PeriodCheck(PERIOD)
    stamps = [*(PERIOD * k for k in range(1000)), *(PERIOD * k - 50.0 for k in range(1000))]
    assert states_until_found(check, stamps) == -1
    assert states_until_found(check, [0.002 * k - 90.0 for k in range(1000)], before=len(stamps)) > 0


def test_what_is_steady_has_a_period_and_what_comes_in_bunches_has_none() -> None:
    assert steady([0.003] * 20) == pytest.approx(0.003)
    assert steady([0.003, 0.0036, 0.0024] * 20) == pytest.approx(0.003)
    assert math.isnan(steady([0.0001, 0.0001, 0.0088] * 20))
    assert math.isnan(steady([0.003, 0.003, 0.006] * 20))


@pytest.mark.parametrize("name", CHANNELS)
@pytest.mark.parametrize("every", [0.001, 0.002, 0.004, 0.006])
def test_a_session_with_such_a_hand_is_a_fault_that_names_both_periods(name: str, every: float) -> None:
    drive = Drive(replace(CHANNELS[name], quartz=every / PERIOD - 1.0), fastest=0.2)
    with pytest.raises(HandFault, match=rf"reports every {1e3 * every:.1f} ms, not every 3 ms.*`period: {every:g}`"):
        for _ in range(600):
            drive.step()
    assert drive.bus.now < 2.0


@pytest.mark.parametrize("every", [0.001, 0.002])
def test_a_fast_hand_is_found_by_a_host_that_is_late_as_well(every: float) -> None:
    drive = Drive(replace(CHANNELS["slcan"], quartz=every / PERIOD - 1.0, pause=0.003), seed=5, fastest=0.2)
    with pytest.raises(HandFault, match="not every 3 ms"):
        for k in range(3000):
            drive.step(0.03 if k % 40 == 39 else 0.0)
