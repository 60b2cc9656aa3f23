"""Which periods a bus can carry."""

from __future__ import annotations

import pytest

from allegro_twin.drivers.dynamixel.codec.budget import budget, check
from allegro_twin.errors import ConfigError


def test_four_servos_at_the_speed_they_come_with_are_asked_39_times_a_second() -> None:
    need = budget(4, 57_600, return_delay=250)
    assert need.size == 136
    assert need.rate == pytest.approx(39.0, abs=0.1)
    assert budget(4, 1_000_000, return_delay=250).rate == pytest.approx(298.0, abs=0.5)
    assert budget(4, 1_000_000).rate == pytest.approx(735.0, abs=0.5)


def test_sixteen_servos_and_their_current_limits_cost_what_they_weigh() -> None:
    assert budget(16, 1_000_000).size == 460
    assert budget(16, 1_000_000, limited=True).size == 460 + 14 + 16 * 3


def test_a_period_that_the_bus_cannot_carry_is_refused_with_both_figures() -> None:
    check(0.01, budget(16, 1_000_000))
    with pytest.raises(ConfigError, match=r"period 0.01 s .* 16 servos at 57600 baud: 460 bytes take 0.07986 s"):
        check(0.01, budget(16, 57_600))
