"""Backends in which a hand's model takes the place of the hand, from an instant of its recording on.

The host reads from the model what it would read from the hand: positions in whole counts, speeds behind its own filter,
torques as its driver lets them through.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from allegro_twin.backend import limp_of, position_of, torque_of
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.driver.velocity_filter import VelocityFilter
from allegro_twin.errors import EndOfRecording
from allegro_twin.recording.reader import Recording
from allegro_twin.sim.model.joints import JointChange
from allegro_twin.sim.observer.loop_observer import LoopObserver
from allegro_twin.sim.observer.observer import StateObserver
from allegro_twin.spec import HandSpec
from allegro_twin.twin.branch.result import BranchOptions
from allegro_twin.twin.identify.motions.motion import noise_floor, recorded_calibration
from allegro_twin.twin.mirror.factory import mirror_for_recording
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.twin.mirror.on_recording import recorded_samples
from allegro_twin.types import Command, HandState, Vector, frozen


class HostReading(NamedTuple):
    """Joint state as a host knows it at the end of a period, (n,) each."""

    position: Vector
    """rad."""
    velocity: Vector
    """rad/s."""
    torque: Vector
    """N·m, over the period."""


class ModelBackend(ABC):
    """A backend that starts at some row of a recording and ends with the recording. Values that the model does not
    have, such as the temperature, stay as they were; gravity is as recorded."""

    live = False
    """Time passes only while this backend reads."""

    def __init__(self, recording: Recording, row: int, mirror: Mirror, state: HandState) -> None:
        """`mirror`: has observed all rows up to this one; `state`: of this row."""
        self._recording, self._mirror, self._begin, self._now = recording, mirror, state, state
        self._told = limp_of(recording.spec)

    @property
    def spec(self) -> HandSpec:
        return self._mirror.spec

    @property
    def period(self) -> float:
        return self._recording.period

    def reset(self) -> HandState:
        """The state at the instant. Can be called once only: the simulation goes on."""
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
        reading = self._simulate_period(self._told, self._mirror.gravity_in_palm(at_row))
        position, velocity, torque = (frozen(each) for each in reading)
        self._now = replace(at_row, position=position, velocity=velocity, torque=torque)
        return self._now

    def close(self) -> None:
        self._told = limp_of(self.spec)

    @abstractmethod
    def _simulate_period(self, command: Command, gravity: Vector) -> HostReading:
        """Simulate one period."""


class TorqueModelBackend(ModelBackend):
    """Model of a hand that takes torques, in counts."""

    def __init__(
        self, recording: Recording, row: int, mirror: Mirror, state: HandState, observer: StateObserver, *, noisy: bool
    ) -> None:
        """`noisy`: encoders are as noisy as in the recording, with the same noise for every model. Under a controller
        this noise shakes the motors, which loosens dry friction."""
        super().__init__(recording, row, mirror, state)
        table, columns = recording.meta["calibration"], recording.columns
        used = recorded_calibration(table)
        self._observer, self._codec = observer, make_codec(table["version"], used)
        self._constant = np.array(used.torque_constant, dtype=float)
        self._rng, self._noise = (
            np.random.default_rng(0),
            recorded_encoder_noise(recording) if noisy else np.zeros(self.spec.n_joints),
        )
        backend = (recording.meta.get("config") or {}).get("backend", {})
        cutoff = float(backend.get("velocity_cutoff", CanHostSettings().velocity_cutoff))
        self._filter = VelocityFilter(cutoff, columns["position"][row], columns["velocity"][row])

    def _simulate_period(self, command: Command, gravity: Vector) -> HostReading:
        lanes = self._codec.positions
        _, torque = self._codec.torques.frames(torque_of(command, self.spec), self._codec.pwm_limits)
        expected = self._observer.alone(torque / self._constant, gravity).predicted
        expected = expected + self._noise * self._rng.standard_normal(len(expected))
        position = lanes.values(lanes.frames(expected).data)
        return HostReading(position, self._filter(position, self.period), torque)


class PositionModelBackend(ModelBackend):
    """Model of a hand that closes its own loop."""

    def __init__(
        self, recording: Recording, row: int, mirror: Mirror, state: HandState, observer: LoopObserver
    ) -> None:
        super().__init__(recording, row, mirror, state)
        self._observer = observer

    def _simulate_period(self, command: Command, gravity: Vector) -> HostReading:
        found = self._observer.alone(position_of(command, self.spec), gravity)
        return HostReading(found.predicted, found.velocity, self._observer.torque)


def recorded_encoder_noise(recording: Recording) -> Vector:
    """Standard deviation of the encoder noise before counts are rounded, (n,), rad. Rounding adds a twelfth of a count
    squared."""
    table = recording.meta["calibration"]
    used = recorded_calibration(table)
    grain = make_codec(table["version"], used).rad_per_count
    seen = np.square(noise_floor(recording.columns["position"], grain))
    return np.asarray(np.sqrt(np.maximum(seen - np.square(grain) / 12.0, 0.0)))


def model_backend_at(
    recording: Recording, row: int, change: JointChange, options: BranchOptions, *, closed: bool
) -> ModelBackend:
    """The hand as its mirror knows it at a row, changed there; `closed`: under a controller. Raises ConfigError for a
    hand that has no mirror."""
    mirror = mirror_for_recording(recording, options.hand, None, options.gravity)
    for sample in islice(recorded_samples(recording), row + 1):
        mirror.observe(sample)
        state = sample.state
    observer = mirror.observer
    if options.disturbance == "forget":
        observer.forget()
    observer.become(change)
    if isinstance(observer, LoopObserver):
        return PositionModelBackend(recording, row, mirror, state, observer)
    return TorqueModelBackend(recording, row, mirror, state, observer, noisy=closed)
