"""Four reports become one hand, whatever the bus does to them, and never one that was not."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import pytest
from hypothesis import given
from hypothesis import strategies as st

from allegro_twin.wire.assembler import Assembler, Whole
from allegro_twin.wire.messages import FingerPosition

PERIOD, GAP = 0.003, 0.00013
"""s; GAP is what a frame of eight bytes takes on a bus of 1 Mbit/s."""


def report(finger: int, value: float) -> FingerPosition:
    return FingerPosition(finger, (value,) * 4)


def told(assembler: Assembler, *reports: tuple[int, float, float]) -> list[Whole]:
    """Finger, value and time of reports; the wholes that they make."""
    made = [assembler.add(report(finger, value), t) for finger, value, t in reports]
    return [whole for whole in made if whole is not None]


def burst(value: float, t: float, order: tuple[int, ...] = (0, 1, 2, 3)) -> list[tuple[int, float, float]]:
    return [(finger, value, t + k * GAP) for k, finger in enumerate(order)]


def test_four_reports_make_a_hand_in_any_order_at_the_time_of_the_last() -> None:
    for order in ((0, 1, 2, 3), (3, 2, 1, 0), (2, 0, 3, 1)):
        (whole,) = told(Assembler(PERIOD), *[(finger, 10.0 + finger, k * GAP) for k, finger in enumerate(order)])
        assert whole.position == (10.0,) * 4 + (11.0,) * 4 + (12.0,) * 4 + (13.0,) * 4
        assert whole.t == 3 * GAP


def test_a_lost_report_costs_its_own_period_and_the_next_in_which_it_might_still_come() -> None:
    assembler = Assembler(PERIOD)
    wholes = told(
        assembler, *burst(0.0, 0.0), *burst(1.0, 0.003)[:3], *burst(2.0, 0.006), *burst(3.0, 0.009), *burst(4.0, 0.012)
    )
    assert [whole.position[0] for whole in wholes] == [0.0, 3.0, 4.0]
    assert (assembler.moments, assembler.incomplete, assembler.doubtful) == (5, 1, 1)


def test_a_report_that_comes_a_period_late_is_not_taken_for_the_next() -> None:
    assembler = Assembler(PERIOD)
    late = (3, 0.0, 0.0029)
    wholes = told(assembler, *burst(0.0, 0.0)[:3], late, *burst(1.0, 0.003), *burst(2.0, 0.006))
    assert [whole.position for whole in wholes] == [(2.0,) * 16]


def test_a_report_that_comes_twice_is_taken_once() -> None:
    assembler = Assembler(PERIOD)
    twice = [one for one in burst(1.0, 0.0) for _ in range(2)]
    assert len(told(assembler, *twice)) == 1
    assert len(told(assembler, *burst(1.0, 0.0006))) == 0  # The whole burst again.
    assert (assembler.moments, assembler.incomplete, assembler.doubtful) == (1, 0, 0)


def test_a_finger_that_contradicts_itself_spoils_its_moment_and_the_next() -> None:
    assembler = Assembler(PERIOD)
    lie = [*burst(0.0, 0.0)[:2], (0, 9.0, 0.0003), *burst(0.0, 0.0004)[2:]]
    wholes = told(assembler, *lie, *burst(1.0, 0.003), *burst(2.0, 0.006), *burst(3.0, 0.009))
    assert [whole.position[0] for whole in wholes] == [2.0, 3.0]
    assert (assembler.doubtful, assembler.incomplete) == (2, 0)


def test_a_stray_report_before_a_burst_costs_two_more_periods_and_not_all_that_follow() -> None:
    bursts = [burst(float(k), k * PERIOD) for k in range(8)]
    stray = (3, 99.0, 3 * PERIOD - 0.001)
    wholes = told(Assembler(PERIOD), *bursts[0], *bursts[1], *bursts[2], stray, *chain(*bursts[3:]))
    assert [whole.position[0] for whole in wholes] == [0.0, 1.0, 2.0, 3.0, 5.0, 6.0, 7.0]


def test_periods_that_a_late_host_stamps_alike_are_told_apart() -> None:
    wholes = told(Assembler(PERIOD), *[(finger, value, 0.01) for value in (0.0, 1.0, 2.0) for finger in range(4)])
    assert [whole.position[0] for whole in wholes] == [0.0, 1.0, 2.0]


def test_a_hand_at_rest_is_a_new_state_every_period() -> None:
    assembler = Assembler(PERIOD)
    wholes = told(assembler, *[one for k in range(10) for one in burst(7.0, k * PERIOD)])
    assert (len(wholes), assembler.moments) == (10, 10)


def test_a_host_that_pauses_within_a_burst_gets_no_state_of_two_periods() -> None:
    """It reads two fingers, sleeps for three periods, and finds the rest of that period before the others."""
    after = [(2, 0.0), (3, 0.0), *[(finger, value) for value in (1.0, 2.0, 3.0) for finger in range(4)]]
    assembler = Assembler(PERIOD)
    wholes = told(assembler, *burst(0.0, 0.0)[:2], *[(f, v, 0.0105) for f, v in after], *burst(4.0, 0.0125))
    assert [whole.position for whole in wholes] == [(3.0,) * 16, (4.0,) * 16]  # Two rounds in order restore trust.


@pytest.mark.parametrize("moves", [0.0, 1.0])
def test_a_host_so_busy_that_it_reads_without_a_pause_still_gets_states(moves: float) -> None:
    """Its stamps lie 0.8 ms apart, evenly, whether the hand is at rest or not; one report is lost at the beginning."""
    said = [(finger, moves * k) for k in range(12) for finger in range(4)]
    del said[6]
    wholes = told(Assembler(PERIOD), *[(f, value, 0.0008 * n) for n, (f, value) in enumerate(said)])
    assert len(wholes) >= 6
    assert all(len(set(whole.position)) == 1 for whole in wholes)


def test_fingers_that_are_late_twice_in_a_row_are_not_mixed_with_those_that_are_not() -> None:
    late = [(3, 0.0, 0.0025), (2, 1.0, 0.0055)]
    bursts = [*burst(0.0, 0.0)[:3], late[0], *burst(1.0, 0.003, (0, 1, 3)), late[1], *burst(2.0, 0.006)]
    wholes = told(Assembler(PERIOD), *bursts, *burst(3.0, 0.009))
    assert [whole.position for whole in wholes] == [(3.0,) * 16]


def test_a_host_that_pauses_within_one_burst_after_another_gets_no_state_of_two_periods() -> None:
    """Each time it finds the end of one burst and the beginning of the next, four reports in all."""
    pieces = [(2, 0.0), (3, 0.0), (0, 1.0), (1, 1.0), (2, 1.0), (3, 1.0), (0, 2.0), (1, 2.0), (2, 2.0), (3, 2.0)]
    cut = [(finger, value, 0.003 * (1 + k // 4) - 0.0001) for k, (finger, value) in enumerate(pieces)]
    assembler = Assembler(PERIOD)
    wholes = told(assembler, *burst(-1.0, -0.003), *burst(0.0, 0.0)[:2], *cut, *burst(3.0, 0.0118), *burst(4.0, 0.0148))
    assert [whole.position[0] for whole in wholes] == [-1.0, 3.0, 4.0]


def test_who_is_silent_is_known_by_finger() -> None:
    assembler = Assembler(PERIOD)
    told(assembler, *burst(0.0, 0.0), *burst(1.0, 0.003)[:3])
    assert assembler.silent(0.002) == [3]


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong in one period."""

    what: str
    finger: int
    amount: float


FAULTS = st.one_of(
    st.builds(Fault, st.just("drop"), st.integers(0, 3), st.just(0.0)),
    st.builds(Fault, st.just("delay"), st.integers(0, 3), st.floats(0.0, PERIOD)),
    st.builds(Fault, st.just("twice"), st.integers(0, 3), st.floats(0.0, PERIOD / 2 - 3 * GAP)),
    st.builds(Fault, st.just("pause"), st.integers(0, 3), st.floats(0.0, 6 * PERIOD)),
)
PERIODS, APART = 40, 10
"""Faults are single: ten periods lie between two of them."""


@given(
    orders=st.lists(st.permutations(range(4)), min_size=PERIODS, max_size=PERIODS),
    usual=st.booleans(),
    moving=st.lists(st.sets(st.integers(0, 3)), min_size=PERIODS, max_size=PERIODS),
    faults=st.lists(FAULTS, min_size=PERIODS // APART - 1, max_size=PERIODS // APART - 1),
)
def test_under_any_single_fault_every_state_is_of_one_period(
    orders: list[list[int]], usual: bool, moving: list[set[int]], faults: list[Fault]
) -> None:
    """Every finger's positions count the periods in which it moved, so a state of two periods would give itself away.

    A fault loses a report, holds it back for up to a period, repeats it, or stops the host's clock for up to six.
    """
    counts, truth, sent = [0.0] * 4, set(), []
    for k in range(PERIODS):
        counts = [count + (finger in moving[k]) for finger, count in enumerate(counts)]
        truth.add(tuple(value for value in counts for _ in range(4)))
        order = range(4) if usual else orders[k]
        sent += [[k, finger, counts[finger], k * PERIOD + slot * GAP] for slot, finger in enumerate(order)]
    for number, fault in enumerate(faults, start=1):
        sent = harmed(sent, APART * number, fault)
    assembler = Assembler(PERIOD)
    wholes = told(assembler, *[(int(finger), value, t) for _, finger, value, t in sorted(sent, key=lambda one: one[3])])
    assert {whole.position for whole in wholes} <= truth
    if usual:  # A pause of six periods may cut the bursts at both its ends.
        assert len(wholes) >= PERIODS - 9 * len(faults)


def harmed(sent: list[list[float]], period: int, fault: Fault) -> list[list[float]]:
    """Frames as period, finger, value and time; after one fault in one period."""
    if fault.what == "pause":
        begin = period * PERIOD + (fault.finger + 0.5) * GAP  # After so many reports of the period's burst.
        end = begin + fault.amount
        return [[k, finger, value, end if begin < t < end else t] for k, finger, value, t in sent]
    out = []
    for one in sent:
        k, finger, value, t = one
        if (k, finger) != (period, fault.finger):
            out.append(one)
        elif fault.what == "delay":
            out.append([k, finger, value, t + fault.amount])
        elif fault.what == "twice":
            out += [one, [k, finger, value, t + fault.amount]]
    return out
