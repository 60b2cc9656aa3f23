"""When a frame came is known on the host's steady clock, whatever happens to the clock of its stamps."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from allegro_twin.drivers.can.link.timestamps import Stamps


def test_a_frame_that_is_read_late_came_when_its_stamp_says() -> None:
    stamps = Stamps()
    stamps.empty(9.999)
    assert stamps(1000.0, 10.0) == pytest.approx(10.0)
    assert stamps(1000.003, 10.050) == pytest.approx(10.003, abs=1e-4)
    assert stamps(1000.006, 10.051) == pytest.approx(10.006, abs=1e-4)


def test_the_least_delay_that_was_seen_is_the_clocks_offset() -> None:
    stamps = Stamps()
    assert stamps(1000.000, 10.002) == pytest.approx(10.002)  # Read 2 ms late, as far as nobody knows.
    assert stamps(1000.010, 10.010) == pytest.approx(10.010)
    assert stamps(1000.020, 10.025) == pytest.approx(10.020, abs=1e-4)


@pytest.mark.parametrize("jump", [3600.0, -3600.0, 10.0, -0.5])
def test_a_clock_that_is_set_moves_nothing(jump: float) -> None:
    stamps = Stamps()
    for k in range(100):
        now = 10.0 + 0.003 * k
        stamp = 1000.0 + now + (jump if k >= 50 else 0.0)
        assert stamps(stamp, now + 1e-4) == pytest.approx(now + 1e-4, abs=0.0012)
        stamps.empty(now + 2e-4)


def test_no_stamp_is_now() -> None:
    assert Stamps()(0.0, 5.0) == 5.0


@given(st.lists(st.tuples(st.floats(-1e9, 1e9), st.floats(0.0, 0.1), st.booleans()), max_size=60))
def test_times_never_go_back_and_are_never_of_the_future(frames: list[tuple[float, float, bool]]) -> None:
    stamps, now, last = Stamps(), 100.0, 0.0
    for stamp, waited, emptied in frames:
        now += waited
        if stamp:
            t = stamps(stamp, now)
            assert last <= t <= now
            last = t
        if emptied:
            stamps.empty(now)


def test_clocks_that_drift_apart_are_followed_by_a_thousandth_of_the_time_and_no_faster() -> None:
    stamps = Stamps()
    assert stamps(1000.0, 10.0) == 10.0
    assert stamps(1010.0, 20.5) == pytest.approx(20.0 + 1e-3 * 10.5)  # Read 0.5 s late: 10.5 s of creep.
    assert stamps(1020.0, 30.015) == pytest.approx(30.015)  # Within what the creep allows it is the reading's time.


def test_a_stamp_a_little_before_the_queue_was_empty_is_jitter_and_one_well_before_it_a_clock_that_was_set() -> None:
    for before, back in ((0.0014, False), (0.0017, True)):  # The creep of half a second adds half a millisecond.
        stamps = Stamps()
        stamps(1000.0, 10.0)
        stamps.empty(10.5)
        stamps(1000.5 - before, 10.51)
        assert stamps.offset is not None
        assert (stamps.offset > -989.995) == back
