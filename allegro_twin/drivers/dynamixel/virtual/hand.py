"""A hand of servos that does not exist: any backend that takes positions, behind a bus."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from allegro_twin.backend import HandBackend
from allegro_twin.drivers.dynamixel.codec.calibration import RAD_PER_TICK, Calibration
from allegro_twin.drivers.dynamixel.codec.shafts import Shafts, of_joints
from allegro_twin.drivers.dynamixel.codec.table import FARTHEST
from allegro_twin.drivers.dynamixel.config import ServoFaultSettings
from allegro_twin.drivers.dynamixel.virtual.bus import Bus
from allegro_twin.drivers.dynamixel.virtual.faults import ServoFaults
from allegro_twin.drivers.dynamixel.virtual.servo import Servo, Wants
from allegro_twin.errors import ConfigError
from allegro_twin.types import Array, HandState, PositionCommand, Vector

_INT16 = 32767


class VirtualServoHand:
    """Virtual hand of servos, whose time passes in `step`, and whose bytes pass through `receive`. Raises ConfigError
    for a hand that servos cannot move.

    `shafts`: what a state says of the actuators, where a joint is not an actuator.
    """

    def __init__(
        self,
        backend: HandBackend,
        calibration: Calibration,
        baud: int,
        *,
        plan: ServoFaultSettings | None = None,
        shafts: Callable[[HandState], Shafts] | None = None,
    ) -> None:
        calibration.check(backend.spec)
        self.backend, self.calibration = backend, calibration
        self._shafts = shafts or of_joints(backend.spec)
        self.servos = [Servo(calibration.model, servo.id, baud) for servo in calibration.servos]
        self.bus = Bus(self.servos)
        self.faults = ServoFaults(plan or ServoFaultSettings(), self.servos)
        self._electronics = threading.Lock()  # They answer while physics are computed.
        self.now = 0.0
        """s since `restart`."""
        self._on = 0.0
        self._loose = dict[int, float]()
        """Shafts that nothing hangs on, ticks."""
        self.restart()
        for servo in self.servos:
            servo.reboot()

    @property
    def name(self) -> str:
        return self.backend.spec.name

    @property
    def period(self) -> float:
        """s of a step."""
        return self.backend.period

    @property
    def limp(self) -> bool:
        """Whether no servo does anything."""
        return not any(servo.wants.current for servo in self.servos)

    @property
    def seconds(self) -> float:
        """For how long the line was used."""
        return self.bus.seconds

    def clear(self) -> None:
        """A pause on the line."""
        self.bus.clear()

    def restart(self) -> None:
        """Begin the scene anew; the servos stay as they are."""
        self.state = self.backend.reset()
        self._steps, self.now = 0, 0.0
        self._told: list[Wants] | None = None
        self._currents: tuple[int, ...] = ()
        self._effort = np.empty(0)
        self._warmth: Vector | None = None
        self._sense()

    def step(self) -> HandState:
        """Let one period pass."""
        with self._electronics:
            self._command()
        self.state = self.backend.read()
        with self._electronics:
            self._pass()
        return self.state

    def _command(self) -> None:
        """What the motors do in the period that begins."""
        self.faults.happen(self._on)
        wants = [self._pull(k, servo.wants) for k, servo in enumerate(self.servos)]
        if wants != self._told:
            goals, currents = zip(*wants, strict=True)
            if currents != self._currents:
                self._currents, self._effort = currents, self.calibration.effort(np.array(currents))
            self.backend.write(PositionCommand(self.calibration.position(np.array(goals)), effort=self._effort))
            self._told = wants

    def _pass(self) -> None:
        """The period is over."""
        self._steps += 1
        self.now = self._steps * self.period
        self._on += self.period
        for servo in self.servos:
            servo.elapse(self.period)
        self._sense()

    def receive(self, data: bytes, baud: int) -> bytes:
        """What comes back of what a host sends at this speed."""
        with self._electronics:
            return self.faults.spoil(self.bus.receive(self.faults.spoil(data), baud))

    def _pull(self, k: int, wants: Wants) -> Wants:
        """What is left at the actuator of what a servo wants: nothing where its tendon is torn, and its shaft runs."""
        if k not in self.faults.torn:
            self._loose.pop(k, None)
            return wants
        servo, unit = self.servos[k], self.calibration.model.velocity_unit / RAD_PER_TICK
        most = servo.memory.get("velocity_limit") * unit * self.period  # Of its data sheet: without a load.
        at = self._loose.setdefault(k, float(servo.shaft))
        self._loose[k] = at + (min(max(wants.goal - at, -most), most) if wants.current else 0.0)
        return Wants(wants.goal, 0)

    def _sense(self) -> None:
        """Tell the servos where their shafts are."""
        shafts, calibration = self._shafts(self.state), self.calibration
        if not np.isfinite(shafts.position).all():
            raise ConfigError(f"{self.backend.spec.name} does not say where its actuators are: give `shafts`")
        velocity = _whole(calibration.velocity_counts(shafts.velocity), FARTHEST)
        current = _whole(calibration.torque_counts(shafts.torque), _INT16)
        rows = zip(self.servos, calibration.ticks(shafts.position), velocity, current, strict=True)
        for k, (servo, tick, speed, draws) in enumerate(rows):
            if k in self._loose:
                servo.sense(round(self._loose[k]), 0, 0)
            else:
                servo.sense(tick, speed, draws)
        warmth = self.state.temperature
        if warmth is not self._warmth and len(warmth) == len(self.servos) and np.isfinite(warmth).all():
            for servo, celsius in zip(self.servos, warmth, strict=True):
                servo.heat(float(celsius))
        self._warmth = warmth
        for k, celsius in self.faults.heat.items():
            self.servos[k].heat(celsius)


def _whole(values: Array, most: int) -> list[int]:
    """What a servo can say of them; what a simulation does not say is 0, for a servo always measures."""
    bounded = np.minimum(np.maximum(values, -most), most)
    bounded[np.isnan(bounded)] = 0.0
    found: list[int] = bounded.astype(int).tolist()
    return found
