"""A link that is loose falls, and is told from an encoder that jumps and from a push."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.control.controllers import PD
from allegro_twin.control.trajectory import Hold
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.loop import run, until
from allegro_twin.sim.drivetrain.backlash import allow_backlash
from allegro_twin.sim.observer.observer import StateObserver
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.results.gap import drive_parameters
from allegro_twin.twin.mirror.loose_link import LooseLinkDetector
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.types import Array
from tests.conftest import MakeSim

N, ROW = 16, 10
FALL = np.array([1.2, 3.3, 5.1, 6.3, -0.5, -6.2, -6.2, -4.4, -2.1, -0.3]) * 1e-3  # A fall of 20 mrad.
JUMP = np.array([20.1, 2.9, -5.8, -8.2, -7.2, -4.8, -2.4, -0.4, 0.8, 1.2]) * 1e-3  # An encoder's, of as many.
IMPACT = np.array([1.3, 3.0, 2.9, 1.8, 0.6, -0.3, -1.2, -1.4, -1.0, -1.3, -1.1, -0.9]) * 1e-3  # 80 g that fall on it.


def said(spec: HandSpec, joint: int, off: Array, beside: float = 0.0, at: int = 14) -> list[tuple[int, float] | None]:
    """Of four rows, in the second of which something happens to a joint, and a share of it to the one before."""
    rows = np.zeros((4 * ROW, N))
    rows[at : at + len(off), joint] = off
    rows[at : at + len(off), joint - 1] = beside * off
    falls = LooseLinkDetector(spec)
    return [falls.add(row) for row in rows.reshape(4, ROW, N)]


@pytest.mark.parametrize("at", range(10, 20))
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_fall_is_seen_once_wherever_rows_end(spec: HandSpec, at: int, way: float) -> None:
    found = [each for each in said(spec, 7, way * FALL, at=at) if each is not None]
    assert found == [(7, 0.0063)]


def test_a_jump_a_push_and_noise_are_no_falls(spec: HandSpec) -> None:
    assert said(spec, 7, JUMP) == [None] * 4
    assert said(spec, 7, FALL, beside=0.5) == [None] * 4
    assert said(spec, 7, np.abs(FALL)) == [None] * 4
    assert said(spec, 7, 0.2 * FALL) == [None] * 4


@pytest.mark.parametrize("at", range(10, 20))
def test_what_falls_on_a_finger_is_no_loose_link(spec: HandSpec, at: int) -> None:
    assert said(spec, 14, IMPACT, at=at) == [None] * 4
    assert said(spec, 14, -2.0 * IMPACT, at=at) == [None] * 4


@pytest.mark.slow
@pytest.mark.parametrize(("what", "name"), [("loose", "loose"), ("encoder_step", "encoder_step")])
def test_a_hand_whose_fingertip_comes_loose_is_called_so(
    spec: HandSpec, make_sim: MakeSim, what: str, name: str
) -> None:
    middle = (spec.lower + spec.upper) / 2.0
    hand = make_sim(allow_backlash(spec, [7]), posture=middle)
    each = Mirror(spec, StateObserver(spec, drive_parameters(spec, np.ones(N), np.zeros(N)), 0.003), np.ones(N))
    done = False
    for sample in each.watch(until(4.0, run(hand, PD(Hold(middle), load_gains("v4", spec))))):
        if not done and sample.state.t >= 2.5:
            assert not each.faults
            hand.suffer(what, 7, 0.05)  # type: ignore[arg-type]
            done = True
    assert [(one.fault.name, one.fault.joint) for one in each.faults] == [(name, 7)]
