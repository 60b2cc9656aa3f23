"""A hand's model in the place of the hand, from an instant of its recording on.

A host hears of it what it would hear of the hand: positions in whole counts, speeds behind its own filter, torques as
its driver lets them through.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from allegro_twin.backend import limp_of, position_of, torque_of
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.driver.settings import HostSettings
from allegro_twin.drivers.can.driver.velocity import VelocityFilter
from allegro_twin.errors import EndOfRecording
from allegro_twin.recording.reader import Recording
from allegro_twin.sim.model.friction_changes import Change
from allegro_twin.sim.observer.loop_observer import LoopObserver
from allegro_twin.sim.observer.observer import Observer
from allegro_twin.spec import HandSpec
from allegro_twin.twin.branch.result import Wanted
from allegro_twin.twin.identify.motions.motion import calibration_of, noise_floor
from allegro_twin.twin.identify.results.hand_file import shift
from allegro_twin.twin.mirror.for_hand import mirror_of, played
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.types import Command, HandState, Vector, frozen


class Heard(NamedTuple):
    """What a host knows of the joints at the end of a period, (n,) each."""

    position: Vector
    """rad."""
    velocity: Vector
    """rad/s."""
    torque: Vector
    """N·m, over the period."""


class Model(ABC):
    """A backend whose reset is the instant, at some row of the recording, and which ends with the recording. What it is
    not asked to be, as the temperature, stays as it was; where down is, is as recorded."""

    live = False
    """Time passes only while this backend reads."""

    def __init__(self, recording: Recording, row: int, mirror: Mirror, state: HandState) -> None:
        """`mirror`: has seen all rows up to this one; `state`: of this row."""
        self._recording, self._mirror, self._begin, self._now = recording, mirror, state, state
        self._told = limp_of(recording.spec)

    @property
    def spec(self) -> HandSpec:
        return self._mirror.spec

    @property
    def period(self) -> float:
        return self._recording.period

    def reset(self) -> HandState:
        """The instant. Once: its simulation goes on."""
        return self._begin

    def write(self, command: Command) -> None:
        self._told = command

    def read(self) -> HandState:
        before, columns = self._now, self._recording.columns
        tick = before.tick + 1
        row = int(np.searchsorted(columns["tick"], tick))
        if row == len(self._recording):
            raise EndOfRecording(f"{self._recording.path} ends at {columns['t'][-1]:.3f} s")
        at_row = replace(before, t=tick * self.period, tick=tick, gravity=columns["gravity"][row])
        heard = self._passed(self._told, self._mirror.down(at_row))
        position, velocity, torque = (frozen(each) for each in heard)
        self._now = replace(at_row, position=position, velocity=velocity, torque=torque)
        return self._now

    def close(self) -> None:
        self._told = limp_of(self.spec)

    @abstractmethod
    def _passed(self, command: Command, gravity: Vector) -> Heard:
        """One period."""


class OnABus(Model):
    """Of a hand that takes torques, in counts."""

    def __init__(
        self, recording: Recording, row: int, mirror: Mirror, state: HandState, observer: Observer, *, noisy: bool
    ) -> None:
        """`noisy`: with encoders as noisy as in the recording, the same noise for every model: under a controller it
        shakes the motors, which loosens dry friction."""
        super().__init__(recording, row, mirror, state)
        table, columns = recording.meta["calibration"], recording.columns
        used = calibration_of(table)
        self._observer, self._codec = observer, make_codec(table["version"], used)
        self._limits, self._constant = np.array(table["pwm_limit"]), np.array(used.torque_constant, dtype=float)
        self._rng, self._noise = (
            np.random.default_rng(0),
            noise_in(recording) if noisy else np.zeros(self.spec.n_joints),
        )
        backend = (recording.meta.get("config") or {}).get("backend", {})
        cutoff = float(backend.get("velocity_cutoff", HostSettings().velocity_cutoff))
        self._filter = VelocityFilter(cutoff, columns["position"][row], columns["velocity"][row])

    def _passed(self, command: Command, gravity: Vector) -> Heard:
        lanes = self._codec.positions
        _, torque = self._codec.torques.frames(torque_of(command, self.spec), self._limits)
        expected = self._observer.alone(torque / self._constant, gravity).predicted
        expected = expected + self._noise * self._rng.standard_normal(len(expected))
        position = lanes.values(b"".join(frame.data for frame in lanes.frames(expected)))
        return Heard(position, self._filter(position, self.period), torque)


class OnALine(Model):
    """Of a hand that closes its own loop."""

    def __init__(
        self, recording: Recording, row: int, mirror: Mirror, state: HandState, observer: LoopObserver
    ) -> None:
        super().__init__(recording, row, mirror, state)
        self._observer = observer

    def _passed(self, command: Command, gravity: Vector) -> Heard:
        found = self._observer.alone(position_of(command, self.spec), gravity)
        return Heard(found.predicted, found.velocity, self._observer.torque)


def noise_in(recording: Recording) -> Vector:
    """Standard deviation of what the encoders add, (n,), rad, before counts are rounded; that adds a twelfth of a count
    squared."""
    table = recording.meta["calibration"]
    used = calibration_of(table)
    count = shift(table["version"], used, tuple(each + 1 for each in used.encoder_offset))
    seen = np.square(noise_floor(recording.columns["position"]))
    return np.asarray(np.sqrt(np.maximum(seen - np.square(count) / 12.0, 0.0)))


def model_at(recording: Recording, row: int, change: Change, wanted: Wanted, *, closed: bool) -> Model:
    """The hand as its mirror knows it at a row, changed there; `closed`: under a controller. Raises ConfigError for a
    hand that has no mirror."""
    mirror = mirror_of(recording, wanted.hand, None, wanted.gravity)
    for sample in islice(played(recording), row + 1):
        mirror.see(sample)
        state = sample.state
    observer = mirror.observer
    if wanted.disturbance == "forget":
        observer.forget()
    observer.become(change)
    if isinstance(observer, LoopObserver):
        return OnALine(recording, row, mirror, state, observer)
    return OnABus(recording, row, mirror, state, observer, noisy=closed)
