"""Four reports become one hand by their order, whatever the host's stamps say, and never one that was not."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from allegro_twin.drivers.can.codec.messages import FingerPosition
from allegro_twin.drivers.can.driver.lost_frames import Assembler, Whole

PERIOD, GAP = 0.003, 0.00013
"""s; GAP is what a frame of eight bytes takes on a bus of 1 Mbit/s."""
Report = tuple[int, float, float]
"""Finger, value, s."""


def told(assembler: Assembler, *reports: Report) -> list[Whole]:
    """The wholes that reports make."""
    made = [assembler.add(FingerPosition(finger, (value,) * 4), t) for finger, value, t in reports]
    return [whole for whole in made if whole is not None]


def burst(value: float, t: float, order: tuple[int, ...] = (0, 1, 2, 3)) -> list[Report]:
    return [(finger, value, t + k * GAP) for k, finger in enumerate(order)]


def values(wholes: list[Whole]) -> list[float]:
    """One value a whole; a whole of two periods fails."""
    assert all(len(set(whole.position)) == 1 for whole in wholes)
    return [whole.position[0] for whole in wholes]


def test_four_reports_in_the_order_of_the_bus_make_a_hand_at_the_time_of_the_last() -> None:
    (whole,) = told(Assembler(PERIOD), *[(finger, 10.0 + finger, k * GAP) for k, finger in enumerate(range(4))])
    assert whole.position == (10.0,) * 4 + (11.0,) * 4 + (12.0,) * 4 + (13.0,) * 4
    assert whole.t == 3 * GAP


def test_a_lost_report_costs_its_own_period_and_the_next_in_which_it_might_still_come() -> None:
    assembler = Assembler(PERIOD)
    wholes = told(
        assembler, *burst(0.0, 0.0), *burst(1.0, 0.003)[:3], *burst(2.0, 0.006), *burst(3.0, 0.009), *burst(4.0, 0.012)
    )
    assert values(wholes) == [0.0, 3.0, 4.0]
    assert (assembler.periods, assembler.incomplete, assembler.doubtful) == (5, 1, 1)


@pytest.mark.parametrize("place", range(4))
def test_a_report_that_comes_a_period_late_is_not_taken_for_the_next(place: int) -> None:
    first, second = burst(0.0, 0.0), burst(1.0, 0.003)
    late = first.pop(place)
    mixed = [*first, *second[:place], (late[0], late[1], second[place][2] - 1e-5), *second[place:]]
    assert values(told(Assembler(PERIOD), *mixed, *burst(2.0, 0.006), *burst(3.0, 0.009)))[-1] == 3.0


@pytest.mark.parametrize("finger", range(4))
def test_a_report_that_comes_twice_costs_two_periods_at_most(finger: int) -> None:
    doubled = [report for report in burst(1.0, 0.003) for _ in range(1 + (report[0] == finger))]
    wholes = told(Assembler(PERIOD), *burst(0.0, 0.0), *doubled, *burst(2.0, 0.006), *burst(3.0, 0.009))
    assert values(wholes)[0] == 0.0
    assert values(wholes)[-1] == 3.0


def test_a_hand_at_rest_is_a_new_state_every_period() -> None:
    assembler = Assembler(PERIOD)
    wholes = told(assembler, *[one for k in range(10) for one in burst(7.0, k * PERIOD)])
    assert (len(wholes), assembler.periods) == (10, 10)


def test_periods_that_a_late_host_stamps_alike_are_told_apart() -> None:
    assert values(
        told(Assembler(PERIOD), *[(finger, value, 0.01) for value in (0.0, 1.0, 2.0) for finger in range(4)])
    ) == [0.0, 1.0, 2.0]


def test_four_reports_that_are_lost_in_one_piece_show_by_the_gap_that_they_leave() -> None:
    """The first of one period and the others of the next: their order is right."""
    torn = [burst(1.0, 0.003)[0], *burst(2.0, 0.006)[1:]]
    wholes = told(Assembler(PERIOD), *burst(0.0, 0.0), *torn, *burst(3.0, 0.009), *burst(4.0, 0.012))
    assert values(wholes) == [0.0, 3.0, 4.0]


def test_what_the_receiver_says_it_lost_costs_two_periods() -> None:
    """Read late, the four that were lost leave no gap: only the receiver knows."""
    assembler = Assembler(PERIOD)
    assert values(told(assembler, *burst(0.0, 0.0), *burst(1.0, 0.009)[:1])) == [0.0]
    assembler.lost()
    late = [(finger, 2.0, 0.0091) for finger in (1, 2, 3)]
    assert values(told(assembler, *late, *burst(3.0, 0.0092), *burst(4.0, 0.0095))) == [4.0]


def late_host(rng: random.Random, periods: int, resting: int | None) -> list[Report]:
    """A healthy bus read by a host that pauses for up to 50 ms and then takes 0.05 to 0.5 ms a frame."""
    reports, now = [], 0.0
    for k in range(periods):
        for finger in range(4):
            now = max(now + rng.uniform(0.00005, 0.0005), k * PERIOD + finger * GAP)
            if rng.random() < 0.002:
                now += rng.uniform(0.0, 0.05)
            reports.append((finger, 0.0 if finger == resting else float(k), now))
    return reports


def whole_again(resting: int | None, periods: int, seed: int) -> tuple[int, int]:
    """States, and the most periods between two, of a healthy bus and a late host; a torn state fails."""
    assembler, used = Assembler(PERIOD), [-1]
    for finger, value, t in late_host(random.Random(seed), periods, resting):
        whole = assembler.add(FingerPosition(finger, (value,) * 4), t)
        if whole is not None:
            (number,) = {whole.position[4 * k] for k in range(4) if k != resting}
            used.append(int(number))
    return len(used) - 1, max(after - before for before, after in pairwise(used))


@pytest.mark.parametrize("resting", [None, 0, 1, 2, 3])
def test_a_late_host_on_a_healthy_bus_gets_whole_hands_within_five_periods(resting: int | None) -> None:
    states, longest = whole_again(resting, 10_000, seed=resting or 7)
    assert longest <= 5
    assert states > 9_000


@pytest.mark.long
@pytest.mark.parametrize("resting", [None, 0, 1, 2, 3])
def test_a_late_host_gets_whole_hands_a_million_periods_long(resting: int | None) -> None:
    _, longest = whole_again(resting, 200_000, seed=100 + (resting or 7))
    assert longest <= 5


GARBAGE = st.lists(st.tuples(st.integers(0, 3), st.floats(-1e6, 1e6, allow_nan=False)), max_size=30)
STAMPS = st.lists(st.floats(-1e9, 1e9, allow_nan=False), min_size=12, max_size=12)


@given(before=GARBAGE, stamps=STAMPS)
def test_after_anything_at_all_three_clean_periods_give_a_state_whatever_their_stamps(
    before: list[tuple[int, float]], stamps: list[float]
) -> None:
    assembler = Assembler(PERIOD)
    for finger, t in before:
        assembler.add(FingerPosition(finger, (-1.0,) * 4), t)
    clean = [(k % 4, float(k // 4), t) for k, t in enumerate(stamps)]
    wholes = told(assembler, *clean)
    assert wholes
    assert values(wholes)[-1] >= 0.0


LOSSES = st.lists(st.tuples(st.integers(4, 150), st.integers(1, 13)), max_size=2)


@given(losses=LOSSES, resting=st.sets(st.integers(0, 3), max_size=3))
def test_losses_of_one_and_of_many_consecutive_reports_never_tear_a_state_of_a_host_in_time(
    losses: list[tuple[int, int]], resting: set[int]
) -> None:
    gone = {first + k for first, many in losses for k in range(many)}
    assembler = Assembler(PERIOD)
    for k in range(160):
        if k in gone:
            continue
        period, finger = divmod(k, 4)
        value = 0.0 if finger in resting else float(period)
        whole = assembler.add(FingerPosition(finger, (value,) * 4), period * PERIOD + finger * GAP)
        if whole is not None:
            assert len({whole.position[4 * each] for each in range(4) if each not in resting}) == 1


@given(
    losses=st.lists(st.tuples(st.integers(4, 150), st.integers(1, 13).filter(lambda n: n % 4)), max_size=1),
    resting=st.sets(st.integers(0, 3), max_size=3),
)
def test_a_loss_that_is_no_multiple_of_four_never_tears_a_state_whatever_the_stamps(
    losses: list[tuple[int, int]], resting: set[int]
) -> None:
    """Order alone shows it: all stamps are alike, as those of a host that reads everything at once."""
    gone = {first + k for first, many in losses for k in range(many)}
    assembler = Assembler(PERIOD)
    for k in range(160):
        if k in gone:
            continue
        period, finger = divmod(k, 4)
        value = 0.0 if finger in resting else float(period)
        whole = assembler.add(FingerPosition(finger, (value,) * 4), 1.0)
        if whole is not None:
            assert len({whole.position[4 * each] for each in range(4) if each not in resting}) == 1
