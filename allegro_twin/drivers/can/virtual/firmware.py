"""The other end of the wire: what a hand's own processor does, over any backend."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from allegro_twin.backend import HandBackend
from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.frames import Frame, JointFrames
from allegro_twin.drivers.can.codec.imu import orientation_of
from allegro_twin.drivers.can.codec.messages import Message, StatusBits, Topic
from allegro_twin.drivers.can.virtual.motor_heat import FAULT, THROTTLE, MotorHeat
from allegro_twin.errors import ConfigError, ProtocolError
from allegro_twin.types import HandState, TorqueCommand, Vector

_LIMP = int(StatusBits.JOINT_HOT | StatusBits.PALM_HOT)
Pressures = Callable[[], Vector]
"""Source of the pressures in the four fingertips, (4,), Pa."""


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity that the hand reports."""

    serial: str = "VIRTUAL1"
    """Up to eight ASCII characters."""
    hardware: int = 0x0400
    firmware: int = 0x0100


class Firmware:
    """A hand without a bus, a thread or a clock: `receive` what the host sends, `step` to let a period pass.

    It says nothing by itself until its motors are on and a period is set, and keeps the last torque of every finger
    for ever. Frames that it cannot read it ignores, as a controller does whose filter they do not pass.
    `restart`: the backend begins anew whenever the motors are switched on, so that a scene starts with the session.
    `servo`: whether the motors must be switched on; without, they follow torques and it reports as soon as it has a
    period, as notes on a real v4 say (docs/reference/can_protocol.md).
    """

    def __init__(
        self,
        backend: HandBackend,
        codec: Codec,
        identity: Identity | None = None,
        *,
        pressures: Pressures | None = None,
        restart: bool = False,
        servo: bool = True,
    ) -> None:
        self._backend, self._codec, self._identity = backend, codec, identity or Identity()
        self._pressures, self._restart, self._needs_servo = pressures, restart, servo
        self._motors = codec.torques.fingers
        if backend.spec.thermal is None:
            raise ConfigError(f"{backend.spec.name}: a virtual hand on CAN warms its motors: give its file `thermal`")
        self.motors = MotorHeat(backend.spec.actuation.torque_limit, backend.spec.thermal, backend.period)
        self._torques = list[Vector]()  # Since the motors were warmed last.
        self.failed: StatusBits = StatusBits(0)
        """Faults that are injected, beside those that happen by themselves."""
        self._limp = TorqueCommand(np.zeros(backend.spec.n_actuators))
        self.power_up()

    @property
    def torque(self) -> Vector:
        """What it was told last, (n,), N·m."""
        return self._codec.torques.values(self._counts)

    @property
    def period(self) -> float:
        """s of a step."""
        return self._backend.period

    @property
    def state(self) -> HandState:
        """The hand as it really is."""
        return self._state

    @property
    def serving(self) -> bool:
        """Whether its motors follow torques."""
        return self._servo if self._needs_servo else bool(self._reports)

    @property
    def codec(self) -> Codec:
        return self._codec

    @property
    def backend(self) -> HandBackend:
        return self._backend

    def power_up(self) -> None:
        """As after switching on: motors off, silent, no torque."""
        self._counts = bytes(2 * self._backend.spec.n_actuators)
        self._told: TorqueCommand | None = None  # Of these counts, once it was needed.
        self._reports: list[tuple[int, Topic]] = []  # Every so many ticks.
        self._ticks = 0
        self._servo = self._fresh = False
        self._state = self._backend.reset()

    def receive(self, frame: Frame | JointFrames) -> list[Frame]:
        """What the hand answers at once."""
        if isinstance(frame, JointFrames):
            if frame.id != self._codec.torques.identifiers:
                return [answer for each in frame.frames for answer in self.receive(each)]
            self._counts, self._told = frame.data, None  # Latched, as on the real hand.
            return []
        finger = self._motors.get(frame.id)
        if finger is not None and len(frame.data) == 8 and not frame.remote:
            self._counts = self._counts[: 8 * finger] + frame.data + self._counts[8 * finger + 8 :]
            self._told = None
            return []
        try:
            message = self._codec.decode(frame)
        except ProtocolError:
            return []
        match message:
            case m.ServoOn():
                self._switch_on()
            case m.ServoOff():
                self._servo = False
            case m.SetPeriod():
                self._set_periods(message)
            case m.Request(topic=topic, finger=finger):
                return self._frames(self._answers(topic, finger))
            case m.Calibrate():
                return self._frames([m.CalibrationDone()])
            case _:
                pass  # Position set-points are "not implemented yet" (manual); the rest changes nothing here.
        return []

    def step(self) -> list[Frame | JointFrames]:
        """Let one step pass; the reports that are due at its end."""
        serving = self._servo if self._needs_servo else bool(self._reports)
        if self._fresh:
            self._fresh = False  # The first report is of the moment at which the motors went on.
        else:
            self._backend.write(self._obeyed() if serving and not int(self.failed) & _LIMP else self._limp)
            self._state = state = self._backend.read()
            self._torques.append(state.torque)
            if len(self._torques) == self.motors.steps:
                self.motors.warm(self._torques)
                self._torques.clear()
        tick, self._ticks = self._ticks, self._ticks + 1
        if not serving:
            return []
        frames = list[Frame | JointFrames]()
        for every, topic in self._reports:
            if tick % every:
                continue
            if topic is Topic.POSITION:
                frames.append(self._codec.positions.frames(self._state.position))
                if self._pressures is None:
                    continue
                frames += self._frames(self._pressed(self._pressures()))
            else:
                frames += self._frames(self._answers(topic, None))
        return frames

    def status(self) -> StatusBits:
        """The manual's status bits."""
        bits = self.failed
        if self._servo:
            bits |= StatusBits.SERVO_ON
        hottest = self.motors.temperature.max()
        if hottest >= THROTTLE:
            bits |= StatusBits.THROTTLED
        if hottest >= FAULT:
            bits |= StatusBits.JOINT_HOT
        return bits

    def close(self) -> None:
        self._backend.close()

    def _switch_on(self) -> None:
        if self._servo:
            return
        self._servo = True
        if self._needs_servo:
            self._begin()

    def _begin(self) -> None:
        """A session starts."""
        self._fresh = True
        self._ticks = 0
        if self._restart:
            self._state = self._backend.reset()

    def _obeyed(self) -> TorqueCommand:
        """What the motors make of the torques that they were told."""
        if not self.motors.cold:
            return TorqueCommand(self.torque * self.motors.share)
        if self._told is None:
            self._told = object.__new__(TorqueCommand)  # Its checks take longer than all of this: counts are finite.
            object.__setattr__(self._told, "torque", self._codec.torques.values(self._counts))
        return self._told

    def _set_periods(self, message: m.SetPeriod) -> None:
        began = self.serving
        topics = (Topic.POSITION, Topic.IMU, Topic.TEMPERATURE, Topic.STATUS)
        periods = (message.position, message.imu, message.temperature, message.status or 0.0)
        self._reports = [
            (max(round(seconds / self.period), 1), topic)
            for topic, seconds in zip(topics, periods, strict=True)
            if seconds > 0.0
        ]
        if not self._needs_servo and self.serving and not began:
            self._begin()

    def _answers(self, topic: Topic, finger: int | None) -> Iterator[Message]:
        fingers = range(4) if finger is None else (finger,)
        match topic:
            case Topic.POSITION:
                position = self._state.position.tolist()
                yield from (m.FingerPosition(k, tuple(position[4 * k : 4 * k + 4])) for k in fingers)
            case Topic.TEMPERATURE:
                celsius = self.motors.temperature.tolist()
                yield from (m.FingerTemperature(k, tuple(celsius[4 * k : 4 * k + 4])) for k in fingers)
            case Topic.IMU:
                if math.isfinite(self._state.gravity.sum()) and self._state.gravity.any():
                    yield m.Imu(orientation_of(self._state.gravity))
            case Topic.STATUS:
                yield m.Status(self.status())
            case Topic.INFORMATION:
                who, palm = self._identity, float(self.motors.temperature.mean())
                yield m.Information(who.hardware, who.firmware, self._backend.spec.side, palm, self.status())
            case Topic.SERIAL:
                yield m.Serial(self._identity.serial)

    @staticmethod
    def _pressed(pascal: Vector) -> Iterator[Message]:
        """Fingertip pressures, (4,), Pa, which a v5 hand reports with its joints."""
        yield m.FingertipPressure((0, 1), (float(pascal[0]), float(pascal[1])))
        yield m.FingertipPressure((2, 3), (float(pascal[2]), float(pascal[3])))

    def _frames(self, messages: Iterator[Message] | list[Message]) -> list[Frame]:
        frames = []
        for message in messages:
            try:
                frames.append(self._codec.encode(message))
            except ProtocolError:
                continue  # This version has no such report.
        return frames
