"""What a third party that only listens makes of a hand and its driver: states, and the torques that followed them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from allegro_twin.errors import ConfigError, ProtocolError
from allegro_twin.types import HandState, Sample, TorqueCommand, Vector, frozen
from allegro_twin.wire import messages as m
from allegro_twin.wire.assembler import Assembler, Whole
from allegro_twin.wire.clock import HandClock
from allegro_twin.wire.codec import Codec
from allegro_twin.wire.frames import Frame
from allegro_twin.wire.imu import gravity_of
from allegro_twin.wire.messages import Four
from allegro_twin.wire.terms import Terms
from allegro_twin.wire.velocity import VelocityFilter

_ENOUGH = 50  # Intervals from which a hand's period is clear.
_STRANGE = 200  # Frames of others that are kept, to say whose they are.
_OFF = 0.2  # Of the period: further off, the config's period is not the hand's.


@dataclass(slots=True)
class Told:
    """What there was in what was heard."""

    frames: int = 0
    states: int = 0
    missed: int = 0
    """Periods without a state."""
    incomplete: int = 0
    """Moments of which some finger's report was lost."""
    malformed: int = 0
    uncommanded: int = 0
    """States before the first torques: their torque is NaN, and their command zero, for a command cannot be NaN."""

    def words(self) -> str:
        """What is not as it should be, in words."""
        parts = {
            "periods without a state": self.missed,
            "moments in which a finger's report was lost": self.incomplete,
            "malformed frames": self.malformed,
            "rows before the first torque frame, whose command is written as 0": self.uncommanded,
        }
        return ", ".join(f"{count} {what}" for what, count in parts.items() if count)


def regular(intervals: Iterable[float]) -> float:
    """The period of something periodic, s; NaN where the intervals differ, as on a busy computer that reads in
    bursts."""
    tenth, middle, ninth = np.percentile(list(intervals), (10, 50, 90))
    return float(middle) if ninth - tenth < _OFF * middle else math.nan


class Heard:
    """Takes frames of one hand and its driver, in their order; gives a sample when the next state is whole."""

    def __init__(self, codec: Codec, terms: Terms, told: Told) -> None:
        self._codec, self._terms, self.told = codec, terms, told
        self._assembler, self._bus = Assembler(terms.period), ""
        self._temperature: Vector = frozen(np.full(16, math.nan))
        self._gravity: Vector = frozen(np.full(3, math.nan) if terms.gravity is None else terms.gravity)
        self._torque = [math.nan] * 16
        self._clock: HandClock | None = None
        self._whole: Whole | None = None
        self._state: HandState | None = None
        self.strange: list[Frame] = []
        """Some frames that are not this hand's."""
        self._sent: dict[int, Four] = {}
        self._intervals: deque[float] = deque(maxlen=_ENOUGH)

    def hear(self, frame: Frame, t: float, bus: str = "") -> Sample | None:
        """One frame at `t` s; the sample that it completes. Raises ConfigError when it cannot be this config's."""
        self.told.frames += 1
        try:
            message = self._codec.decode(frame)
        except ProtocolError:
            self.told.malformed += 1
            return None
        match message:
            case m.FingerPosition():
                return self._report(message, t, bus)
            case m.SetTorque(finger=finger, torque=torque):
                self._settle()
                self._sent.setdefault(finger, torque)
                self._torque[4 * finger : 4 * finger + 4] = torque  # Latched, as in the hand.
            case None if len(self.strange) < _STRANGE:
                self.strange.append(frame)
            case m.ServoOff():
                self._torque = [0.0] * 16
            case m.FingerTemperature(finger=finger, temperature=celsius):
                values = self._temperature.copy()
                values[4 * finger : 4 * finger + 4] = celsius
                self._temperature = frozen(values)
            case m.Imu(orientation=orientation) if self._terms.gravity is None:
                self._gravity = gravity_of(orientation)
        return None

    def end(self) -> Sample | None:
        """The last sample; None when there was no whole hand at all."""
        self._settle()
        return self._sample()

    def _report(self, message: m.FingerPosition, t: float, bus: str) -> Sample | None:
        if bus != (self._bus or bus):
            raise ConfigError(f"hands report on {self._bus} and on {bus}: say which with --bus")
        self._bus = bus
        self._settle()
        whole = self._assembler.add(message, t)
        if whole is None:
            return None
        done = self._sample()
        self._latched = frozen(self._torque)
        self._whole, self._sent = whole, {}
        return done

    def _settle(self) -> None:
        """The state is over when the next thing happens: what a hand reports with its joints comes after them."""
        whole, self._whole = self._whole, None
        if whole is None:
            return
        position, moments = frozen(whole.position), self._assembler.moments
        if self._clock is None:
            self._clock = HandClock(self._terms.period, whole.t, moments)
            self._filter, velocity = VelocityFilter(self._terms.velocity_cutoff, position), frozen(np.zeros(16))
        else:
            before = self._clock.t
            periods = self._clock.advance(whole.t, moments)
            self._check_period(self._clock.t - before)
            self.told.missed += periods - 1
            velocity = self._filter(position, periods * self._terms.period)
        self.told.states, self.told.incomplete = self.told.states + 1, self._assembler.incomplete
        clock = self._clock
        self._state = HandState(
            clock.t, clock.tick, position, velocity, self._latched, self._temperature, self._gravity
        )

    def _sample(self) -> Sample | None:
        state, self._state = self._state, None
        if state is None:
            return None
        torque = self._latched.tolist()
        for finger, sent in self._sent.items():
            torque[4 * finger : 4 * finger + 4] = sent
        self.told.uncommanded += any(map(math.isnan, torque))
        return Sample(state, TorqueCommand(np.nan_to_num(torque, nan=0.0)))

    def _check_period(self, interval: float) -> None:
        self._intervals.append(interval)
        found = regular(self._intervals) if self.told.states == _ENOUGH else math.nan
        if abs(found / self._terms.period - 1.0) > _OFF:
            raise ConfigError(
                f"this hand reports every {found * 1000:.1f} ms; the config says period: {self._terms.period:g} s"
            )
