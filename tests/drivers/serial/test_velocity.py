"""A hand that says only where it is has true speeds, however late its questions and answers are."""

from __future__ import annotations

import random

import numpy as np
import pytest

from allegro_twin.drivers.base.difference_quotient import DifferenceQuotient, Exchanged
from allegro_twin.drivers.base.lockstep import LockstepLine
from allegro_twin.drivers.base.serial_line import SerialLine
from allegro_twin.drivers.polled.host_settings import PolledHostSettings
from allegro_twin.types import HandState, PositionCommand
from tests.drivers.serial.polled_rigs import KINDS, Kind, Polled, scale_of
from tests.drivers.serial.rigs import PERIOD

STEP = 0.001
"""s of the hand; its host asks every `PERIOD`."""


class StallingPort(LockstepLine):
    """The hand moves on while its host stalls: before a question, or before it reads the answer."""

    rng = random.Random(0)
    chance, longest = 0.05, 0.5
    lockstep = False

    def send(self, data: bytes) -> None:
        self._stall()
        super().send(data)

    def receive(self, most: int, seconds: float) -> bytes:
        data = super().receive(most, seconds)
        self._stall()
        return data

    def _stall(self) -> None:
        if self.rng.random() < self.chance:
            self.wait(self.now() + self.rng.uniform(0.0, self.longest))


def stalling(port: SerialLine, seed: int) -> StallingPort:
    assert isinstance(port, LockstepLine)
    made = StallingPort(port.hand, port.baud)
    made.rng = random.Random(seed)
    return made


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 4))])
@pytest.mark.parametrize("kind", [pytest.param(kind, marks=pytest.mark.slow if kind == "qb" else ()) for kind in KINDS])
def test_however_a_host_stalls_no_speed_is_reported_that_no_joint_had(kind: Kind, seed: int) -> None:
    from tests.drivers.serial.polled_rigs import virtual

    hand = virtual(kind, period=STEP)
    fastest, step = [0.0], hand.step

    def watched() -> HandState:
        before = hand.state.position
        state = step()
        fastest.append(float(np.abs(state.position - before).max()) / STEP)
        return state

    hand.step = watched  # type: ignore[method-assign]
    settings = PolledHostSettings(PERIOD, watchdog=5.0)
    polled = Polled(kind, there=hand, wrap=lambda port: stalling(port, seed), settings=settings)
    backend, reported = polled.backend, [0.0]
    backend.reset()
    lower, upper = (np.full(polled.n, end) for end in (0.1, 1.0))
    for k in range(400 if seed else 160):
        backend.write(PositionCommand(upper if k // 40 % 2 else lower, duration=0.5))
        reported.append(float(np.abs(backend.read().velocity).max()))
    tick = scale_of(kind).per_tick.max() / PERIOD
    assert max(reported) <= 1.2 * max(fastest) + 2.0 * tick
    assert max(reported) > 0.3 * max(fastest)  # And they are no zeros.


def test_a_late_answer_is_compared_with_nothing_and_the_next_with_the_one_before_it() -> None:
    speed = DifferenceQuotient(np.array([0.0]), Exchanged(0.0, 0.001))
    assert speed(np.array([0.01]), Exchanged(0.010, 0.011))[0] == pytest.approx(1.0)
    held = speed(np.array([0.02]), Exchanged(0.020, 0.300))[0]  # Asked in time; the host slept before it read.
    assert held == pytest.approx(1.0)
    assert speed(np.array([0.604]), Exchanged(0.302, 0.303))[0] == pytest.approx(0.594 / 0.292)


def test_an_adapter_that_holds_every_answer_for_long_costs_no_speeds() -> None:
    speed = DifferenceQuotient(np.array([0.0]), Exchanged(0.0, 0.016))
    for k in range(1, 20):
        found = speed(np.array([0.04 * k]), Exchanged(0.02 * k, 0.02 * k + 0.016))
        assert found[0] == pytest.approx(2.0)


def test_a_first_answer_that_came_late_spoils_no_speed() -> None:
    speed = DifferenceQuotient(np.array([0.0]), Exchanged(0.0, 0.4))  # It was asked at once, or only just now.
    for k in range(1, 60):
        found = speed(np.array([0.39 + 0.01 * k]), Exchanged(0.4 + 0.01 * k, 0.401 + 0.01 * k))
        assert found[0] <= 1.2
    assert found[0] == pytest.approx(1.0)
