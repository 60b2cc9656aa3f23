"""What goes wrong on a virtual bus goes wrong as often as it is said to, and as it is said to."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.config import BusFaultEvent, FaultSettings
from allegro_twin.drivers.can.virtual.faults import BusFaults
from allegro_twin.hands.description.specs import load_spec

FRAME = Frame(0b101_0101_0101, bytes([0b1010_1010] * 8))
HAND: Any = SimpleNamespace()


def many(count: int) -> list[Frame]:
    return [Frame(k, bytes([k % 256])) for k in range(count)]


class Drawn:
    """A chance that draws what it is told, and keeps between what it was asked to draw."""

    def __init__(self, *numbers: int) -> None:
        self.left, self.below = list(numbers), list[int]()

    def integers(self, below: int) -> int:
        self.below.append(below)
        return self.left.pop(0)


@pytest.mark.parametrize("bit", range(11 + 64 + 1))
def test_a_frame_that_is_spoilt_has_one_bit_turned_over_or_is_cut_short(bit: int) -> None:
    """The first eleven are of its identifier; then stands its length, and then its data."""
    faults = BusFaults(FaultSettings(corrupt=1.0))
    drawn = Drawn(bit, 3)
    faults._rng = drawn  # type: ignore[assignment]  # Looks alike.
    spoilt = faults._corrupted(FRAME)
    if bit < 11:
        assert (spoilt.id, spoilt.data) == (FRAME.id ^ 2**bit, FRAME.data)
    elif bit == 11:
        assert (spoilt.id, spoilt.data) == (FRAME.id, FRAME.data[:3])
    else:
        assert spoilt.id == FRAME.id
        flipped = int.from_bytes(spoilt.data, "little") ^ int.from_bytes(FRAME.data, "little")
        assert flipped == 2 ** (bit - 12)
    assert drawn.below[0] == 76
    assert drawn.below[1:] in ([], [9])


def test_frames_are_lost_doubled_and_spoilt_as_often_as_is_said() -> None:
    frames = many(4000)
    lost = BusFaults(FaultSettings(drop=0.25)).to_hand(frames)
    assert len(lost) == pytest.approx(3000, abs=120)
    assert set(lost) < set(frames)
    doubled = BusFaults(FaultSettings(duplicate=0.25)).to_hand(frames)
    assert len(doubled) == pytest.approx(5000, abs=120)
    assert list(dict.fromkeys(doubled)) == frames
    assert all(doubled[k] in (doubled[k - 1], frames[frames.index(doubled[k - 1]) + 1]) for k in range(1, 60))
    spoilt = BusFaults(FaultSettings(corrupt=0.25)).to_hand(frames)
    assert len(spoilt) == 4000
    assert sum(a != b for a, b in zip(spoilt, frames, strict=True)) == pytest.approx(1000, abs=120)
    assert BusFaults(FaultSettings()).to_hand(frames) == frames
    assert BusFaults(FaultSettings(seed=3, drop=0.5)).to_hand(frames) == BusFaults(
        FaultSettings(seed=3, drop=0.5)
    ).to_hand(frames)


def test_a_frame_that_is_held_back_arrives_so_much_later() -> None:
    faults = BusFaults(FaultSettings(delay=1.0, delay_by=0.5))
    frames = many(3)
    assert faults.due == math.inf
    assert faults.from_hand(frames[:2], 1.0, HAND) == []
    assert faults.from_hand(frames[2:], 1.25, HAND) == []
    assert faults.due == 1.5
    assert faults.late(1.49) == []
    assert faults.late(1.5) == frames[:2]
    assert faults.due == 1.75
    assert faults.late(2.0) == frames[2:]
    assert faults.late(9.0) == []
    some = BusFaults(FaultSettings(delay=0.25)).from_hand(many(4000), 0.0, HAND)
    assert len(some) == pytest.approx(3000, abs=120)


def test_frames_of_one_moment_come_in_another_order_and_none_is_lost() -> None:
    frames = many(6)
    turns = [BusFaults(FaultSettings(reorder=1.0, seed=seed)).from_hand(frames, 0.0, HAND) for seed in range(20)]
    assert all(sorted(each) == frames for each in turns)
    assert sum(each != frames for each in turns) >= 19
    faults = BusFaults(FaultSettings(reorder=0.25))
    seldom = sum(faults.from_hand(frames, 0.0, HAND) != frames for _ in range(2000))
    assert seldom == pytest.approx(500, abs=80)
    assert faults.from_hand(frames[:1], 0.0, HAND) == frames[:1]


def test_a_hand_off_the_bus_hears_nothing_and_what_was_held_back_is_gone() -> None:
    faults = BusFaults(FaultSettings(delay=1.0, script=(BusFaultEvent(at=2.0, what="bus_off"),)))
    faults.from_hand(many(3), 0.0, HAND)
    faults.happen(1.9, [HAND])
    assert not faults.cut
    faults.happen(2.0, [HAND])
    assert faults.cut
    assert faults.bus_off
    assert faults.to_hand(many(2)) == []
    assert faults.from_hand(many(2), 2.0, HAND) == []
    assert faults.due == math.inf


def test_events_happen_in_the_order_of_their_times_and_once_and_a_recovery_ends_them() -> None:
    motors = SimpleNamespace(temperature=np.full(16, 25.0))
    powered: list[bool] = []
    hand: Any = SimpleNamespace(motors=motors, failed=0, step=0.003, power_up=lambda: powered.append(True))
    script = (
        BusFaultEvent(at=3.0, what="recover"),
        BusFaultEvent(at=1.0, what="overheat", which=5),
        BusFaultEvent(at=2.0, what="power_cut"),
    )
    faults = BusFaults(FaultSettings(script=script))
    faults.happen(1.0, [hand])
    assert motors.temperature[5] > 60.0
    assert not faults.cut
    faults.happen(2.5, [hand])
    faults.happen(2.6, [hand])
    assert faults.cut
    assert not faults.bus_off
    assert powered == [True]
    faults.happen(3.0, [hand])
    assert not faults.cut
    assert motors.temperature.tolist() == [25.0] * 5 + [30.0] + [25.0] * 10


def test_hands_fail_by_chance_so_often_a_minute() -> None:
    suffered: list[tuple[str, int, float]] = []
    backend = SimpleNamespace(
        suffer=lambda what, joint, amount: suffered.append((what, joint, amount)),
        spec=load_spec(),
    )
    hand: Any = SimpleNamespace(backend=backend, period=0.003)
    faults = BusFaults(FaultSettings(failures=60.0))
    for _ in range(40_000):  # Two minutes.
        faults.happen(0.0, [hand])
    assert len(suffered) == pytest.approx(120, abs=35)
    assert {joint for _, joint, _ in suffered} == set(range(16)) or len({joint for _, joint, _ in suffered}) > 12
    assert all(joint % 4 == 3 for what, joint, _ in suffered if what == "loose")
    BusFaults(FaultSettings()).happen(0.0, [HAND])
