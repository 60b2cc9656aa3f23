"""Two v4 hands and their drivers on one bus of 1 Mbit/s, frame by frame, as arbitration lets them through."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

import numpy as np
import pytest

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.frames import Frame, bits
from allegro_twin.drivers.can.codec.messages import Topic
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.driver.interpreter import Interpreter

PERIOD, DRIFT = 0.003, 3e-4
"""s; by which the second hand's quartz is slow: each moment of the one meets each of the other in 10 s."""
BEGIN = (0.1, 0.3)
"""rad: what tells the first hand from the second."""


def said(codec: Codec, device: int, period: float, seconds: float) -> Iterator[tuple[float, Frame]]:
    """When a hand puts which frames up for sending, s: joints, each 0.5 s temperatures, each second its status."""
    for k in range(int(seconds / period)):
        for finger in range(4):
            yield k * period, codec.encode(m.FingerPosition(finger, (BEGIN[device] + 1e-4 * (k % 100),) * 4))
        for finger in range(4 if k % 167 == 0 else 0):
            yield k * period, codec.encode(m.FingerTemperature(finger, (30.0,) * 4))
        if k % 333 == 0:
            yield k * period, codec.encode(m.Information(0x0400, 0x0100, "right", 30.0, m.StatusBits.SERVO_ON))


def told(codec: Codec, period: float, seconds: float) -> Iterator[tuple[float, Frame]]:
    """What its driver says, 1 ms after the reports."""
    torques, _ = codec.torques.frames(np.full(16, 0.1), codec.pwm_limits)
    for k in range(int(seconds / period)):
        yield from ((k * period + 0.001, frame) for frame in torques.frames)
        if k % 333 == 0:
            yield k * period + 0.001, codec.encode(m.Request(Topic.INFORMATION))


def arbitrated(senders: list[list[tuple[float, Frame]]]) -> Iterator[tuple[float, float, Frame]]:
    """When each frame has arrived and when it was ready, s. Each sender has one frame after the other up; the lowest
    identifier goes first, and no frame is interrupted."""
    queues, now = [deque(sorted(sender, key=lambda entry: entry[0])) for sender in senders], 0.0
    while waiting := [queue for queue in queues if queue]:
        now = max(now, min(queue[0][0] for queue in waiting))
        ready, frame = min((queue for queue in waiting if queue[0][0] <= now), key=lambda q: q[0][1].id).popleft()
        now += bits(len(frame.data)) * 1e-6
        yield now, ready, frame


@pytest.mark.parametrize("one_computer", [True, False])
def test_on_a_full_bus_every_report_of_two_hands_comes_in_its_period_and_to_its_driver(one_computer: bool) -> None:
    """`one_computer`: both drivers share an adapter, where a frame waits for those before it."""
    codecs, periods, seconds = [make_codec("v4", device=k) for k in (0, 1)], (PERIOD, PERIOD * (1 + DRIFT)), 10.0
    hands = [list(said(codecs[k], k, periods[k], seconds)) for k in (0, 1)]
    drivers = [list(told(codecs[k], periods[k], seconds)) for k in (0, 1)]
    ears = [Interpreter(codec, CanHostSettings()) for codec in codecs]
    states: list[list[float]] = [[], []]
    worst = 0.0
    for t, ready, frame in arbitrated([*hands, *([drivers[0] + drivers[1]] if one_computer else drivers)]):
        worst = max(worst, t - ready) if any(frame.id in codec.positions.fingers for codec in codecs) else worst
        for ear, seen in zip(ears, states, strict=True):
            ear.hear(frame, t)
            if ear.whole is not None:
                seen.extend(ear.state(np.zeros(16)).position.tolist())
    for k, (ear, seen) in enumerate(zip(ears, states, strict=True)):
        assert len(seen) == 16 * int(seconds / periods[k])
        assert ear.incomplete == ear.health.doubtful == ear.health.missed == 0
        np.testing.assert_allclose(seen, BEGIN[k] + 0.005, atol=0.006)
    assert worst < 9 * bits(8) * 1e-6 + 2e-4  # All eight reports, and one that had begun.
