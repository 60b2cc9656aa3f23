"""Joint speeds from counts are right at rest, right at speed and late by a known time."""

from __future__ import annotations

import math

import numpy as np
import pytest

from allegro_twin.drivers.can.driver.velocity_filter import VelocityFilter
from allegro_twin.types import frozen

PERIOD, CUTOFF = 0.003, 30.0


def test_its_gain_is_one() -> None:
    """Unlike the manufacturer's filter, which reads 1 % low: R4 allegro_node.cpp:131."""
    low_pass = VelocityFilter(CUTOFF, frozen([0.0]))
    for k in range(1, 500):
        velocity = low_pass(frozen([2.0 * k * PERIOD]), PERIOD)
    assert velocity[0] == pytest.approx(2.0, rel=1e-9)


def test_it_is_late_by_its_time_constant_and_half_a_period() -> None:
    """On a ramp of speed a, v lags by a (1 / (2π f_c) + Δt/2), the second part being the quotient's own."""
    low_pass, a = VelocityFilter(CUTOFF, frozen([0.0])), 5.0
    for k in range(1, 1000):
        t = k * PERIOD
        velocity = low_pass(frozen([a * t * t / 2]), PERIOD)
    share = 1 - math.exp(-2 * math.pi * CUTOFF * PERIOD)
    exactly = PERIOD * (1 - share) / share + PERIOD / 2
    assert (a * t - velocity[0]) / a == pytest.approx(exactly, rel=1e-6)
    assert exactly == pytest.approx(1 / (2 * math.pi * CUTOFF), rel=0.05)


def test_a_step_of_speed_is_followed_like_a_low_pass_of_that_frequency() -> None:
    low_pass = VelocityFilter(CUTOFF, frozen([0.0]))
    for k in range(1, 4):
        velocity = low_pass(frozen([1.0 * k * PERIOD]), PERIOD)
        assert velocity[0] == pytest.approx(1 - math.exp(-2 * math.pi * CUTOFF * k * PERIOD), rel=1e-9)


def test_missed_periods_do_not_make_a_joint_look_faster() -> None:
    steady, gapped = VelocityFilter(CUTOFF, frozen([0.0])), VelocityFilter(CUTOFF, frozen([0.0]))
    for k in range(1, 13):
        every = steady(frozen([k * PERIOD]), PERIOD)
        if k % 3 == 0:
            third = gapped(frozen([k * PERIOD]), 3 * PERIOD)
    np.testing.assert_allclose(third, every, rtol=1e-12)
    assert third.flags.writeable is False


def test_a_joint_that_stands_still_has_no_speed() -> None:
    low_pass = VelocityFilter(CUTOFF, frozen([0.7]))
    assert all(low_pass(frozen([0.7]), PERIOD)[0] == 0.0 for _ in range(10))
