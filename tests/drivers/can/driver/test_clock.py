"""Ticks count the hand's periods, however the host stamps its frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from allegro_twin.drivers.can.codec.frames import single
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.driver.clock import HandClock
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.tools.samples import Found, Samples
from allegro_twin.hands.description.calibration import load_wiring

PERIOD = 0.003


def ticks(clock: HandClock, *heard: tuple[float, int]) -> list[int]:
    """Ticks after states with these stamps (s) and numbers of moments begun."""
    out = []
    for t, moments in heard:
        clock.advance(t, moments)
        out.append(clock.tick)
    return out


def test_a_state_a_period_is_a_tick_a_period() -> None:
    clock = HandClock(PERIOD, 100.0, 1)
    assert ticks(clock, *[(100.0 + k * PERIOD, 1 + k) for k in range(1, 500)]) == list(range(1, 500))
    assert clock.t == pytest.approx(499 * PERIOD)


def test_moments_that_were_heard_but_not_whole_are_ticks() -> None:
    assert ticks(HandClock(PERIOD, 0.0, 1), (3 * PERIOD, 4)) == [3]


def test_two_or_more_silent_periods_show_at_once_and_one_after_three_states() -> None:
    assert ticks(HandClock(PERIOD, 0.0, 1), (4 * PERIOD, 2)) == [4]
    late = [((k + 1) * PERIOD, 1 + k) for k in range(1, 6)]  # One period is missing before the first.
    assert ticks(HandClock(PERIOD, 0.0, 1), *late) == [1, 2, 4, 5, 6]


def test_a_state_that_is_merely_late_is_no_missed_period() -> None:
    stamps = [0.0031, 0.0085, 0.0091, 0.0121]
    assert ticks(HandClock(PERIOD, 0.0, 1), *[(t, 2 + k) for k, t in enumerate(stamps)]) == [1, 2, 3, 4]


def test_a_host_whose_clock_is_set_back_loses_no_time() -> None:
    clock = HandClock(PERIOD, 50.0, 1)
    ticks(clock, (50.003, 2), (50.006, 3), (17.0, 4), (17.003, 5), (17.006, 6))
    assert clock.tick == 5
    assert clock.t == pytest.approx(0.015)


def test_a_stamp_that_is_earlier_by_rounding_is_no_clock_that_was_set_back() -> None:
    heard = [(0.0031, 2), (0.009, 3), (0.009 - 1e-15, 4), (0.012, 5), (0.015, 6)]
    clock = HandClock(PERIOD, 0.0, 1)
    assert ticks(clock, *heard) == [1, 2, 3, 4, 5]
    assert clock.t == pytest.approx(0.015)


def test_a_state_that_was_late_and_counted_as_lost_periods_is_corrected_by_those_that_come_after_it() -> None:
    clock = HandClock(PERIOD, 0.0, 1)
    clock.advance(1 * PERIOD, 2)
    clock.advance(4 * PERIOD, 3)  # Two late: counted as lost.
    clock.advance(5 * PERIOD, 6, caught_up=False)  # They come now, and more is waiting.
    clock.advance(6 * PERIOD, 7)
    assert clock.tick == 6
    assert clock.t == pytest.approx(6 * PERIOD)


def heard(rate: float, scatter: float, lost: set[int], n: int = 20_000) -> tuple[HandClock, list[int], list[int]]:
    """A hand whose period is longer than it was told by a share, heard up to `scatter` periods late; the clock, its
    ticks, and the true ones."""
    late, kept = np.random.default_rng(3).uniform(0.0, scatter, n), [k for k in range(n) if k not in lost]
    clock, counted = HandClock(PERIOD, 0.0, 1), [0]
    for begun, k in enumerate(kept[1:], start=2):
        clock.advance((k * (1.0 + rate) + late[k]) * PERIOD, begun)
        counted.append(clock.tick)
    return clock, counted, kept


@pytest.mark.parametrize("scatter", [0.0, 0.1])
@pytest.mark.parametrize("rate", [0.0, 1e-4, 1e-3, 0.005, 0.01, -1e-3, -0.005])
def test_a_quartz_that_is_not_the_hosts_is_no_loss(rate: float, scatter: float) -> None:
    clock, counted, true = heard(rate, scatter, set())
    assert counted == true
    assert clock.rate == pytest.approx(rate, abs=6e-4)


@pytest.mark.parametrize("scatter", [0.0, 0.1])
@pytest.mark.parametrize("rate", [0.0, 0.005, -0.005])
def test_losses_of_a_hand_whose_quartz_is_not_the_hosts_are_counted(rate: float, scatter: float) -> None:
    """Bursts of 50 ms and single periods of which nothing was heard."""
    bursts = {k for begin in range(1000, 19_000, 1600) for k in range(begin, begin + 17)}
    clock, counted, true = heard(rate, scatter, bursts | set(range(500, 19_000, 1777)))
    assert abs(counted[-1] - true[-1]) <= 1
    assert clock.rate == pytest.approx(rate, abs=6e-4)


def test_a_bus_log_of_a_slow_hand_has_every_period_and_its_velocities() -> None:
    codec = make_codec("v4", load_wiring().calibration)
    settings, found = CanHostSettings(gravity=(0.0, 0.0, -9.81)), Found()
    samples, speed = Samples(codec, settings, found), 0.3
    last = None
    for k in range(3000):
        t = k * PERIOD * 1.005
        for number, said in enumerate(single([codec.positions.frames(np.full(16, speed * t))])):
            last = samples.hear(said, t + 1.2e-4 * number) or last
    assert (found.states, found.missed) == (2999, 0)
    assert last is not None
    np.testing.assert_allclose(last.state.velocity, speed, rtol=0.06)  # Half a count a period is 5 %.


LATE_FOR_60 = {8: 1.0, 9: 1.0, 10: 1.0, 12: 2.0, 13: 2.0, 15: 2.0, 16: 2.25, 19: 2.0, 20: 2.25, 23: 2.25, 26: 2.0}
LATE_FOR_60 |= {28: 1.0, 29: 2.0, 30: 2.25, 49: 2.0, 50: 2.0, 52: 2.0, 54: 2.0, 55: 2.0, 56: 1.75, 107: 2.0}


def test_what_a_late_host_made_count_too_many_is_no_faster_hand() -> None:
    """Three windows in a row come earlier by their count; the first by more than any quartz is off."""
    clock, stamp = HandClock(PERIOD, 0.0, 1), 0.0
    for k in range(1, 301):
        stamp = max(stamp, (k + LATE_FOR_60.get(k, 0.0)) * PERIOD)
        clock.advance(stamp, 1 + k)
        assert clock.rate == 0.0
        assert 0 <= clock.tick - k <= 2


@example(lateness=[LATE_FOR_60.get(k, 0.0) for k in range(1, 301)])
@given(lateness=st.lists(st.floats(0.0, 2.4), min_size=300, max_size=300))
def test_under_any_lateness_of_the_host_time_and_tick_agree(lateness: list[float]) -> None:
    """Stamps are late by up to 2.4 periods, and frames come in order. A host whose lateness falls evenly over 40 states
    looks like a faster hand, and misleads the count a little more."""
    clock, stamp, most = HandClock(PERIOD, 0.0, 1), 0.0, 3
    before = (-1, -1.0)
    for k, late in enumerate(lateness, start=1):
        stamp = max(stamp, (k + late) * PERIOD)
        clock.advance(stamp, 1 + k)
        assert clock.tick > before[0]
        assert clock.t > before[1]
        before = clock.tick, clock.t
        most = 3 if most == 3 and clock.rate == 0.0 else 9
        assert abs(clock.tick - k) <= most
    for k in range(301, 320):  # A host in time again; a tick cannot be taken back.
        clock.advance(k * PERIOD, 1 + k)
    assert 0 <= clock.tick - 319 <= most
