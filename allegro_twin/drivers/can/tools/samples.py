"""Samples from passive listening to a hand and its driver: states, and the torques that followed them."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import FINGERS, Codec
from allegro_twin.drivers.can.codec.detect import contradiction, reporting
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.messages import Four
from allegro_twin.drivers.can.driver.clock import OFF, steady
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.driver.interpreter import Interpreter
from allegro_twin.drivers.can.driver.startup import mismatch
from allegro_twin.errors import ConfigError
from allegro_twin.types import HandState, Sample, TorqueCommand, frozen

_REPORTS = 8 * len(FINGERS)  # The newest, by which order and doubles are told.
_ENOUGH = 50  # Intervals without a loss from which a hand's period is clear.


@dataclass(slots=True)
class Found:
    """Contents of a passive recording."""

    frames: int = 0
    states: int = 0
    missed: int = 0
    """Periods without a state."""
    incomplete: int = 0
    """Times that a finger's report was lost, late or double."""
    malformed: int = 0
    uncommanded: int = 0
    """States before the first torques: their torque is NaN, and their command zero, for a command cannot be NaN."""
    buses: set[str] = field(default_factory=set)
    """Names of those with a frame."""
    cut: str = ""
    """What the end of a log is cut in: a `line`, which is left out, or a `block`; empty: neither."""

    def summary(self) -> str:
        """What is not as it should be, in words."""
        parts = {
            "periods without a state": self.missed,
            "times that a finger's report was lost": self.incomplete,
            "malformed frames": self.malformed,
            "rows before the first torque frame, whose command is written as 0": self.uncommanded,
        }
        said = [f"{count} {what}" for what, count in parts.items() if count]
        return ", ".join([*said, *([f"a last {self.cut} that is cut"] if self.cut else [])])


class Samples:
    """Takes frames of one hand and its driver, in their order; gives a sample when the next state is whole.

    `side`: of the config's hand; one that says another of itself is refused, unless the settings ask for no identity.
    """

    def __init__(self, codec: Codec, settings: CanHostSettings, found: Found, side: str | None = None) -> None:
        self._codec, self._settings, self.found, self._bus = codec, settings, found, ""
        self._side = side if settings.identify else None
        self._wrong: dict[str, str] = {}
        """By bus, why the hand there is another than the config's."""
        self._interpreter = Interpreter(codec, settings)
        self._latched = frozen(self._interpreter.torque)
        self._state: HandState | None = None
        self._sent: dict[int, Four] = {}
        self._before, self._intervals = math.nan, deque[float](maxlen=_ENOUGH)
        self._reported = deque[int](maxlen=_REPORTS)

    def hear(self, frame: Frame, t: float, bus: str = "") -> Sample | None:
        """One frame at `t` s; the sample that it completes. Raises ConfigError when it cannot be this config's."""
        self.found.frames += 1
        reports = frame.id in self._codec.positions.fingers and not frame.remote
        if reports:
            self._stay(bus)
            self._reported.append(self._codec.positions.fingers[frame.id])
        if reports or frame.id in self._codec.torques.fingers:
            self._settle()
        message = self._interpreter.hear(frame, t)
        if other := contradiction(self._codec, frame):
            self._wrong[bus] = other
        self.found.malformed = self._interpreter.health.malformed
        if isinstance(message, m.Information | m.Serial) and self._side is not None:
            self._wrong[bus] = mismatch(message, self._codec, self._side) or self._wrong.get(bus, "")
        if reports and (why := self._wrong.get(bus)):
            raise ConfigError(why)
        if isinstance(message, m.SetTorque):
            self._sent.setdefault(message.finger, message.torque)
        if not reports or self._interpreter.whole is None:
            return None
        done = self._sample()
        self._latched, self._sent = frozen(self._interpreter.torque), {}
        return done

    def end(self) -> Sample | None:
        """The last sample; None when there was no whole hand at all."""
        self._settle()
        return self._sample()

    @property
    def instead(self) -> str:
        """Which other hands report, in words."""
        return reporting(self._interpreter.others)

    @property
    def disorder(self) -> str:
        """Why the reports of this hand make no whole one, in words; empty where their order does not show it."""
        fingers, n = list(self._reported), len(FINGERS)
        if len(fingers) < _REPORTS:
            return ""
        if any(fingers[k:-1:2] == fingers[k + 1 :: 2] for k in (0, 1)):
            return "each report is there twice: keep one of the two"
        if fingers[n:] != fingers[:-n] or len(set(fingers[:n])) < n:
            return ""
        first = fingers.index(0)
        names = ", ".join(FINGERS[finger] for finger in fingers[first : first + n])
        return f"fingers report in the order {names}; a hand's is {', '.join(FINGERS)}"

    def _stay(self, bus: str) -> None:
        if bus != (self._bus or bus):
            raise ConfigError(f"hands report on {self._bus} and on {bus}: say which with --bus")
        self._bus = bus

    def _settle(self) -> None:
        """The state is over when the next thing happens: what a hand reports with its joints comes after them."""
        if self._interpreter.whole is None:
            return
        self._state = state = self._interpreter.state(self._latched)
        health = self._interpreter.health
        self.found.states, self.found.missed, self.found.incomplete = health.states, health.missed, health.incomplete
        if not math.isnan(self._before):
            self._check_period(state.t - self._before)
        self._before = state.t

    def _sample(self) -> Sample | None:
        state, self._state = self._state, None
        if state is None:
            return None
        torque = self._latched.tolist()
        for finger, sent in self._sent.items():
            torque[4 * finger : 4 * finger + 4] = sent
        self.found.uncommanded += any(map(math.isnan, torque))
        return Sample(state, TorqueCommand(np.nan_to_num(torque, nan=0.0)))

    def _check_period(self, interval: float) -> None:
        self._intervals.append(interval)
        found = self._interpreter.own_period
        if self.found.states == _ENOUGH and not self.found.incomplete:  # A log may be shorter than a session.
            slow = steady(list(self._intervals))
            found = slow if slow > (1.0 + OFF) * self._settings.period else found
        if not math.isnan(found):
            raise ConfigError(
                f"this hand reports every {found * 1000:.1f} ms; the config says period: {self._settings.period:g} s"
            )
