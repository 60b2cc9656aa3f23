"""Whether the time between two whole hands is known: by how late each came, in periods."""

from __future__ import annotations

import pytest

from allegro_twin.drivers.can.driver.clock import Continuity

PERIOD = 0.01


class Heard:
    """A hand that is heard once a period, so many periods late."""

    def __init__(self) -> None:
        self.now = Continuity(PERIOD, 0.0, 0)
        self.count = 0

    def late(self, *periods: float, skipped: int = 0) -> list[bool]:
        found = []
        for by in periods:
            self.count += 1
            self.now.hear((self.count + skipped + by) * PERIOD, self.count)
            found.append(self.now.certain)
        return found


def test_a_hand_that_comes_in_its_time_is_certain_and_counted() -> None:
    heard = Heard()
    assert heard.now.certain
    assert heard.late(0.0, 0.5, 0.74, 0.1) == [True] * 4
    assert (heard.now.periods, heard.now.epoch) == (4, 0)


def test_a_hand_that_is_three_quarters_of_a_period_late_is_doubtful_until_it_is_in_time_again() -> None:
    heard = Heard()
    assert heard.late(0.76, 0.0, 0.9, 0.9, 0.2) == [False, True, False, False, True]
    assert heard.now.epoch == 0


def test_what_stays_late_over_three_whole_hands_was_lost_and_a_new_epoch_begins() -> None:
    heard = Heard()
    assert heard.late(1.0, 1.0, 1.0) == [False, False, True]
    assert heard.now.epoch == 1
    assert heard.late(1.0, 1.0) == [True, True], "from there on that is in time"
    assert heard.late(0.0) == [False], "and what comes a period before it is early"
    assert heard.now.epoch == 2


def test_who_catches_up_has_lost_nothing() -> None:
    heard = Heard()
    assert heard.late(3.0, 2.4, 1.8, 1.2, 0.0) == [False, False, False, False, True]
    assert heard.now.epoch == 0


def test_a_hand_that_is_a_quarter_early_shows_that_all_before_were_late_and_is_certain_after_three() -> None:
    heard = Heard()
    assert heard.late(-0.24) == [True]
    heard = Heard()
    assert heard.late(-0.26, 0.0, 0.0, 0.0) == [False, False, True, True]
    assert heard.now.epoch == 1


def test_a_stamp_within_half_a_period_of_the_one_before_is_of_a_backlog() -> None:
    heard = Heard()
    heard.late(0.0)
    assert not heard.now.backlog
    heard.late(0.6, 0.05)
    assert heard.now.backlog
    heard.late(0.0)
    assert not heard.now.backlog
    heard.late(-0.51 + 0.02)
    assert not heard.now.backlog


def test_frames_that_were_lost_begin_a_new_epoch() -> None:
    heard = Heard()
    heard.now.lost()
    heard.now.lost()
    assert heard.now.epoch == 2


def test_a_quartz_that_is_slow_by_a_ten_thousandth_is_followed() -> None:
    heard = Heard()
    assert all(heard.late(*(1e-4 * k for k in range(20_000))))
    assert heard.now.epoch == 0


def test_a_period_that_is_known_better_is_one_epoch() -> None:
    heard = Heard()
    heard.late(*(0.005 * k for k in range(40)))
    heard.now.tune(1.005 * PERIOD)
    assert all(heard.late(*(0.005 * k for k in range(40, 2000))))
    assert heard.now.epoch == 0


def test_a_period_that_was_learnt_to_be_another_one_is_trusted_less() -> None:
    heard = Heard()
    heard.late(0.0, 0.0)
    heard.now.tune(1.02 * PERIOD)
    assert heard.late(0.745) == [True]
    assert heard.late(0.80) == [False], "0.745 by the new period, of which 0.02 may be wrong"


@pytest.mark.parametrize("gone", [2, 5])
def test_periods_of_which_nothing_was_heard_are_found_by_their_number(gone: int) -> None:
    heard = Heard()
    heard.late(0.1, 0.1)
    assert heard.late(0.1, 0.1, 0.1, skipped=gone) == [False, False, True]
    assert heard.late(0.2, skipped=gone) == [True]
    assert heard.late(0.2, skipped=gone + 1) == [False]
