"""Reported speeds stay true across stalls, full receive buffers, bursts and losses, over every kind of link."""

from __future__ import annotations

import random
from collections import deque
from dataclasses import dataclass, replace
from typing import Any

import can
import numpy as np
import pytest

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.link.adapter import AdapterLink
from allegro_twin.errors import LinkTimeout
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.safety import Guard, Limits
from allegro_twin.types import HandState, TorqueCommand

V4, PERIOD, FRAME = make_codec("v4"), 0.003, 0.00013
STILL = TorqueCommand(np.zeros(16))
COUNT = np.radians(333.3 / 65536)
"""rad: what rounding adds to a difference of two positions, at most."""


@dataclass(frozen=True)
class Channel:
    """What lies between a hand and its host."""

    buffer: int
    """Frames that wait to be read at most; those that come to a full one are lost."""
    stamped: bool
    """Whether a stamp says when a frame came; else when it was read."""
    read: float = 2e-5
    """s to read a frame."""
    work: float = 0.0008
    """s that the host computes between two states."""
    quartz: float = 0.0
    """Share by which the hand's period is longer than the host believes."""
    frame_loss: float = 0.0
    period_loss: float = 0.0
    double: float = 0.0
    swapped: float = 0.0
    pause: float = 0.0
    """Chance, each period, that the sender's end holds all frames back for up to 0.5 s, and then hands them over at
    once."""
    holds: int = 10_000
    """Frames that the sender's end holds back at most; those that come then are lost."""


CHANNELS = {
    "slcan": Channel(buffer=186, stamped=False),  # A terminal holds 4095 bytes: 186 lines of 22.
    "slow slcan": Channel(buffer=186, stamped=False, read=2e-4),
    "small slcan": Channel(buffer=24, stamped=False),
    "socketcan": Channel(buffer=278, stamped=True),
    "small socketcan": Channel(buffer=40, stamped=True),
    "socketcand": Channel(buffer=100_000, stamped=True),
    "socketcand, late": Channel(buffer=100_000, stamped=False),
}


class StallingBus(can.BusABC):
    """A hand that reports over a channel, on a clock of its own; `now` jumps where the host stalls."""

    lockstep = True

    def __init__(self, channel: Channel, seed: int, fastest: float) -> None:
        self.channel, self.rng, self.fastest = channel, random.Random(seed), fastest
        self.now, self.dropped = 0.0, 0
        self._k, self._on, self._held = 0, False, 0.0
        self._sent = deque[tuple[float, Frame]]()  # On their way, with when they come.
        self._waiting = deque[tuple[float, Frame]]()  # In the receive buffer, with when they came.
        self.turn = self.rng.uniform(0.3, 1.5)
        self.channel_info = "stalling"
        super().__init__("stalling")

    def position(self, k: int) -> float:
        """Of all joints, rad: to and fro at the fastest speed."""
        way = self.fastest * k * PERIOD * (1.0 + self.channel.quartz)
        return abs((way + self.turn) % (2.0 * self.turn) - self.turn) - 0.5 * self.turn

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        said = V4.decode(Frame(msg.arbitration_id, bytes(msg.data), msg.is_remote_frame))
        if isinstance(said, m.ServoOn | m.ServoOff):
            self._on = isinstance(said, m.ServoOn)
        if isinstance(said, m.Request):
            bits = m.StatusBits.SERVO_ON if self._on else m.StatusBits(0)
            self._waiting.append((self.now, V4.encode(m.Information(0x400, 0x100, "right", 25.0, bits))))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        end = self.now + (timeout or 0.0)
        while True:
            self._arrive()
            if self._waiting:
                came, frame = self._waiting.popleft()
                self.now += self.channel.read
                stamp = came if self.channel.stamped else self.now
                return can.Message(
                    timestamp=stamp, arbitration_id=frame.id, is_extended_id=False, data=frame.data, dlc=len(frame.data)
                )
            coming = self._sent[0][0] if self._sent else self._due(self._k + 1)
            if coming > end:
                self.now = max(self.now, end)
                return None
            self.now = max(self.now, coming)

    def _due(self, k: int) -> float:
        return k * PERIOD * (1.0 + self.channel.quartz)

    def _arrive(self) -> None:
        """Everything that was sent by now, and what of it has room."""
        while self._due(self._k + 1) <= self.now:
            self._k += 1
            self._report()
        while self._sent and self._sent[0][0] <= self.now:
            if len(self._waiting) < self.channel.buffer:
                self._waiting.append(self._sent.popleft())
            else:
                self._sent.popleft()
                self.dropped += 1

    def _report(self) -> None:
        rng, channel, due = self.rng, self.channel, self._due(self._k)
        if not self._on or rng.random() < channel.period_loss:
            return
        if rng.random() < channel.pause:
            self._held = max(self._held, due + rng.uniform(0.0, 0.5))
        frames = [V4.encode(m.FingerPosition(finger, (self.position(self._k),) * 4)) for finger in range(4)]
        if rng.random() < channel.swapped:
            one = rng.randrange(3)
            frames[one], frames[one + 1] = frames[one + 1], frames[one]
        for slot, frame in enumerate(frames):
            if rng.random() < channel.frame_loss:
                continue
            come = due + slot * FRAME
            for _ in range(2 if rng.random() < channel.double else 1):
                if come < self._held and len(self._sent) >= channel.holds:
                    self.dropped += 1
                else:
                    self._sent.append((max(come, self._held), frame))


class OwnClock(AdapterLink):
    """A link whose host can be late, on the bus's own clock."""

    def __init__(self, bus: StallingBus) -> None:
        super().__init__(bus)
        self.lockstep = False
        self._own = bus

    def now(self) -> float:
        return self._own.now

    def _on_our_clock(self, stamp: float, now: float) -> float:
        return stamp


class Drive:
    """A backend on such a bus."""

    def __init__(self, channel: Channel, seed: int = 0, fastest: float = 0.5) -> None:
        self.bus = StallingBus(channel, seed, fastest)
        settings = CanHostSettings(gravity=(0.0, 0.0, -9.81), deadman=None, keeper=False, timeout=1.5)
        self.backend = CanBackend(load_spec(), V4, lambda: OwnClock(self.bus).port(), settings)
        self.backend.reset()

    def step(self, stall: float = 0.0) -> HandState:
        self.backend.write(STILL)
        self.bus.now += max(self.bus.channel.work, stall)
        return self.backend.read()

    def limit(self) -> float:
        """rad/s: 1.2 times the true maximum, and what rounding to counts adds."""
        return 1.2 * self.bus.fastest + float(COUNT) / PERIOD


def fastest_reported(states: list[HandState]) -> float:
    return max(float(np.abs(state.velocity).max()) for state in states)


@pytest.mark.parametrize("name", CHANNELS)
@pytest.mark.parametrize("stall", [0.004, 0.02, 0.07, 0.13, 0.2, 0.31, 0.5])
def test_after_a_stall_no_speed_is_reported_that_no_joint_had(name: str, stall: float) -> None:
    for seed in range(3):
        drive = Drive(CHANNELS[name], seed)
        states = [drive.step() for _ in range(20)]
        for _ in range(2):
            states += [drive.step(stall + drive.bus.rng.uniform(0.0, PERIOD))]
            states += [drive.step() for _ in range(12 + drive.bus.rng.randrange(8))]
        assert fastest_reported(states) <= drive.limit()
        assert all(np.isfinite(state.velocity).all() for state in states)


@pytest.mark.parametrize("name", ["slcan", "socketcan"])
def test_twenty_periods_after_a_stall_the_speed_is_the_true_one_again(name: str) -> None:
    drive = Drive(CHANNELS[name], seed=1, fastest=0.2)
    drive.bus.turn = 2.0  # One way only.
    for _ in range(50):
        drive.step()
    for stall in (0.05, 0.3, 0.5):
        ticks = drive.step(stall).tick
        for _ in range(20):
            state = drive.step()
        np.testing.assert_allclose(np.abs(state.velocity), 0.2, rtol=0.1)
        assert ticks < state.tick


def test_a_guard_holds_on_through_a_stall_that_costs_reports() -> None:
    drive = Drive(CHANNELS["slcan"], fastest=3.0)
    spec = load_spec()
    wide = np.full(16, 10.0)
    guard = Guard(drive.backend, Limits(spec.actuation.torque_limit, np.full(16, 3.7), -wide, wide))
    guard.reset()
    for k in range(200):
        guard.write(STILL)
        drive.bus.now += 0.35 if k % 60 == 30 else 0.0008
        guard.read()
    assert drive.bus.dropped > 100


TROUBLE: dict[str, dict[str, Any]] = {
    "lost frames": {"frame_loss": 0.02},
    "lost periods": {"period_loss": 0.05},
    "double frames": {"double": 0.02},
    "frames out of order": {"swapped": 0.02},
    "a sender that pauses": {"pause": 0.01},
    "a sender that pauses and holds little": {"pause": 0.01, "holds": 80},
    "a fast quartz": {"quartz": -0.002},
    "a slow quartz": {"quartz": 0.002},
    "all of it": {"frame_loss": 0.01, "period_loss": 0.01, "double": 0.01, "swapped": 0.01, "pause": 0.005},
}


def spoilt(channel: Channel, trouble: str, seed: int, periods: int) -> tuple[Drive, list[HandState]]:
    """A hand that stalls now and then on top of the trouble."""
    drive = Drive(replace(channel, **TROUBLE[trouble]), seed, fastest=0.5)
    states = []
    for _ in range(periods):
        stall = drive.bus.rng.uniform(0.0, 0.5) if drive.bus.rng.random() < 0.01 else 0.0
        try:
            states.append(drive.step(stall))
        except LinkTimeout:
            states.append(drive.backend.reset())
    return drive, states


@pytest.mark.parametrize("trouble", TROUBLE)
@pytest.mark.parametrize("name", ["slcan", "socketcan", "socketcand, late"])
def test_whatever_a_channel_does_no_speed_is_reported_that_no_joint_had(name: str, trouble: str) -> None:
    drive, states = spoilt(CHANNELS[name], trouble, seed=7, periods=400)
    assert fastest_reported(states) <= drive.limit()


@pytest.mark.long
@pytest.mark.parametrize("trouble", TROUBLE)
@pytest.mark.parametrize("name", CHANNELS)
def test_over_many_seeds_no_speed_is_reported_that_no_joint_had(name: str, trouble: str) -> None:
    for seed in range(8):
        drive, states = spoilt(CHANNELS[name], trouble, seed, periods=1000)
        assert fastest_reported(states) <= drive.limit(), seed


@pytest.mark.parametrize("trouble", ["lost frames", "lost periods", "double frames", "frames out of order"])
def test_a_trouble_that_comes_now_and_then_costs_speeds_for_a_short_time_only(trouble: str) -> None:
    drive = Drive(replace(CHANNELS["socketcan"], **TROUBLE[trouble]), seed=3, fastest=0.2)
    drive.bus.turn = 2.0  # One way only.
    states = [drive.step() for _ in range(600)][50:]
    speeds = np.array([np.abs(state.velocity).max() for state in states])
    np.testing.assert_allclose(speeds, 0.2, rtol=0.2)
    assert len(np.unique(speeds)) > 0.5 * len(speeds)  # And they are not merely the last that was known.


@pytest.mark.parametrize("slow", [0.0045, 0.010, 0.031])
def test_a_host_that_is_slower_than_its_hand_has_true_speeds(slow: float) -> None:
    drive = Drive(replace(CHANNELS["slcan"], work=slow), fastest=0.2)
    drive.bus.turn = 2.0
    states = [drive.step() for _ in range(200)][30:]
    speeds = np.array([np.abs(state.velocity).max() for state in states])
    np.testing.assert_allclose(speeds, 0.2, rtol=0.1)
    assert len(np.unique(speeds)) > 0.3 * len(speeds)
