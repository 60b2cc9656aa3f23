"""Interpreter of CAN frames: messages of a hand and its driver, and the states that they form.

The one interpreter of what is heard: of a session, of a checkup, of a log.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import FINGERS, Codec
from allegro_twin.drivers.can.codec.detect import of_other_device
from allegro_twin.drivers.can.codec.frames import LOST, Frame
from allegro_twin.drivers.can.codec.imu import gravity_of
from allegro_twin.drivers.can.codec.messages import Message
from allegro_twin.drivers.can.driver.clock import Continuity, HandClock, PeriodCheck
from allegro_twin.drivers.can.driver.health import Health
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.driver.lost_frames import Assembler, Whole
from allegro_twin.drivers.can.driver.velocity_filter import VelocityFilter
from allegro_twin.drivers.can.link.shared_bus import Stamped, StampedJoints
from allegro_twin.errors import ProtocolError
from allegro_twin.types import HandState, Vector, frozen

OTHERS = 400
"""Frames that are not this hand's and are kept, to say whose they are."""


class Interpreter:
    """Takes frames in their order; `whole` is the newest hand that is not yet a state, and `state` makes it one."""

    def __init__(self, codec: Codec, settings: CanHostSettings, health: Health | None = None) -> None:
        self._codec, self._settings, self._health = codec, settings, health or Health()
        self._period = settings.period
        self._fingers, self._read = codec.positions.fingers, codec.positions.values
        self._identifiers = codec.positions.identifiers
        self._assembler = Assembler(settings.period)
        self._clock: HandClock | None = None
        self._continuity: Continuity | None = None
        self._pace = PeriodCheck(settings.period)
        self._filter: VelocityFilter
        self._epoch = self._periods = 0  # Of the position that the filter has.
        self._before = 0  # Reports up to the last state.
        self.whole: Whole | None = None
        self.others: deque[Frame] = deque(maxlen=OTHERS)
        """The newest frames that are not this hand's."""
        joints = 4 * len(FINGERS)
        self.torque = [math.nan] * joints
        """What the motors were told last, N·m; NaN for what was not heard."""
        self.temperature: Vector = frozen(np.full(joints, math.nan))
        """°C."""
        self.gravity: Vector = frozen(np.full(3, math.nan) if settings.gravity is None else settings.gravity)
        """In the palm frame, m/s²."""

    @property
    def health(self) -> Health:
        """What was counted so far."""
        self._health.incomplete, self._health.doubtful = self._assembler.incomplete, self._assembler.doubtful
        return self._health

    @property
    def own_period(self) -> float:
        """The period that the hand keeps, s, where it is clearly not the one of the settings; else NaN."""
        return self._pace.found

    @property
    def heard(self) -> list[float]:
        """When each finger reported last, s; -inf: never."""
        return self._assembler.heard

    @property
    def incomplete(self) -> int:
        """Times that a finger's report was lost, late or double."""
        return self._assembler.incomplete

    @property
    def reports(self) -> int:
        """Number of finger reports taken in so far."""
        return self._assembler.reports

    def hear_all(self, queue: deque[Stamped | StampedJoints]) -> None:
        """Take in all frames of a queue, which is empty then, as `hear` does one after the other."""
        while queue:
            came = queue.popleft()
            if isinstance(came, Stamped):
                self.hear(*came)
            elif came[0].id == self._identifiers and not self._assembler.group:
                whole = self._assembler.add_all(came[0].data, came[1])
                if whole is not None and self._continuity is not None:
                    self.whole = whole
                    self._follow(came[1])
                elif whole is not None:
                    self._complete(whole)
            else:
                for frame in came.frames.frames:
                    self.hear(frame, came.t)

    def hear(self, frame: Frame, t: float) -> Message | None:
        """Take one frame in, at `t` s, or LOST. What it said, but for
        reports of joints, and for what is nobody's or cannot be read."""
        if frame is LOST:
            self._assembler.lost()
            if self._continuity is not None:
                self._continuity.lost()
            self._health.note("overflows", "the receiver lost frames")
            return None
        finger = self._fingers.get(frame.id)
        if finger is not None and len(frame.data) == 8 and not frame.remote:
            whole = self._assembler.add((finger, frame.data), t)
            if whole is not None:
                self._complete(whole)
            return None
        try:
            message = self._codec.decode(frame)
        except ProtocolError as error:
            self._health.note("malformed", error)
            return None
        if message is None:
            self.others.append(frame)
            if not of_other_device(self._codec.version, frame.id):
                self._health.note("unknown", f"frame {frame}")
            return None
        self._take(message, frame)
        return message

    def sent(self, torque: list[float]) -> None:
        """The motors were told these torques, N·m, by whoever hears this."""
        self.torque = torque

    def position(self, whole: Whole) -> Vector:
        """The joints of a whole hand, (n,), rad."""
        return self._read(whole.position)

    def state(self, torque: Vector, *, caught_up: bool = True) -> HandState:
        """The newest whole hand as a state; `torque` was applied over the period that it ends, N·m. `caught_up`: there
        was nothing left to read. Where it is not known how long ago the last one was, the velocity is the last that is
        known."""
        whole, self.whole, continuity, health, clock = self.whole, None, self._continuity, self._health, self._clock
        assert whole is not None  # Callers look at `whole` first.
        assert continuity is not None
        position, periods = self._read(whole.position), continuity.periods
        if clock is None:
            self._clock = clock = HandClock(self._settings.period, whole.t, periods)
            self._filter = VelocityFilter(self._settings.velocity_cutoff, position)
            self._epoch, self._periods = continuity.epoch, periods
        else:
            gone = clock.advance(whole.t, periods, caught_up=caught_up and not continuity.backlog)
            health.missed += gone - 1
            period = self._period * (1.0 + clock.rate)
            continuity.tune(period)
            if continuity.certain:
                if self._epoch == continuity.epoch:
                    self._filter(position, (periods - self._periods) * period)
                else:
                    self._filter.restart(position)
                self._epoch, self._periods = continuity.epoch, periods
        health.states += 1
        self._before = self._assembler.reports
        if not caught_up:
            health.behind += 1
        return HandState(clock.t, clock.tick, position, self._filter.velocity, torque, self.temperature, self.gravity)

    def silent(self, timeout: float) -> str:
        """Which fingers have fallen silent; empty when all have, or none has."""
        heard = self._assembler.heard
        names = [FINGERS[k] for k in range(len(FINGERS)) if heard[k] < max(heard) - timeout / 2]
        return ", ".join(names)

    def _complete(self, whole: Whole) -> None:
        self.whole = whole
        if self._continuity is None:
            self._continuity = Continuity(self._settings.period, whole.t, self._assembler.periods)
        self._follow(whole.t)

    def _follow(self, t: float) -> None:
        """A whole hand came, at `t` s."""
        assembler, health = self._assembler, self._health
        self._continuity.hear(t, assembler.periods)  # type: ignore[union-attr]  # It begins with the first whole hand.
        self._pace.hear(t, assembler.periods, assembler.incomplete + health.overflows + health.behind)

    def _take(self, message: Message, frame: Frame) -> None:
        """Keep what it says."""
        match message:
            case m.FingerTemperature(finger=finger, temperature=celsius):
                values = self.temperature.copy()
                values[4 * finger : 4 * finger + 4] = celsius
                self.temperature = frozen(values)
            case m.Imu(orientation=orientation) if self._settings.gravity is None:
                self.gravity = gravity_of(orientation)
            case m.SetTorque(finger=finger, torque=torque):
                self.torque = list(self.torque)
                self.torque[4 * finger : 4 * finger + 4] = torque  # Latched, as in the hand.
            case m.ServoOff():
                self.torque = [0.0] * len(self.torque)
            case _:
                pass
