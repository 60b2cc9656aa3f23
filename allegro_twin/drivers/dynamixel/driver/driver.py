"""A hand of DYNAMIXEL servos: what is said to them, and what they answer."""

from __future__ import annotations

from typing import Any

import numpy as np

from allegro_twin.drivers.base.driver import Answer
from allegro_twin.drivers.dynamixel.codec.calibration import Calibration
from allegro_twin.drivers.dynamixel.codec.shafts import Joints, to_joints
from allegro_twin.drivers.dynamixel.driver import prepare
from allegro_twin.drivers.dynamixel.driver.host_settings import ServoHostSettings
from allegro_twin.drivers.dynamixel.driver.line import SdkLine
from allegro_twin.drivers.dynamixel.driver.motors import ServoMotors
from allegro_twin.drivers.dynamixel.driver.reading import Reading
from allegro_twin.drivers.dynamixel.driver.sdk import Sdk
from allegro_twin.errors import LinkError
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector


class ServoDriver:
    """`joints`: how joints follow from actuators."""

    def __init__(
        self,
        spec: HandSpec,
        calibration: Calibration,
        line: SdkLine,
        settings: ServoHostSettings,
        joints: Joints | None = None,
    ) -> None:
        self._spec, self._calibration, self._settings = spec, calibration, settings
        self._joints = joints or to_joints(spec)
        self._names = calibration.names(spec.joint_labels)
        self._sdk = Sdk(line, calibration.model, self._names, settings.tries)
        self._motors = ServoMotors(self._sdk, calibration, settings.watchdog_counts)
        self._next = 0
        self._fresh()

    @property
    def on(self) -> bool:
        return self._motors.on

    @on.setter
    def on(self, value: bool) -> None:
        self._motors.on = value

    @property
    def calibration(self) -> dict[str, Any]:
        return self._calibration.described()

    @property
    def shutdown_frames(self) -> bytes:
        return self._sdk.shutdown_frames()

    def find(self) -> None:
        prepare.find(self._sdk, self._calibration)

    def wake(self) -> None:
        self._sdk.alerts.clear()
        prepare.wake(self._sdk, self._calibration, self._names)
        prepare.settle(self._sdk, self._calibration, self._settings.return_delay)
        self._fresh()

    def first(self) -> Answer:
        self._reading.first_temperatures()
        answer = self.ask()
        prepare.check_place(self._spec, answer.actuators, self._calibration)
        return answer

    def go(self, position: Vector, effort: Vector | None) -> None:
        if not self._motors.on:
            self._motors.start(position, effort)
        else:
            self._motors.currents(effort)
            self._motors.goals(position)

    def again(self, position: Vector) -> None:
        """A goal is never confirmed: it is said every period."""
        self._motors.goals(position)

    def stop(self) -> None:
        if why := self._motors.stop():
            raise LinkError(why)

    def ask(self) -> Answer:
        shafts, n = self._reading.state(), self._spec.n_joints
        joints = self._joints(shafts)
        same = n == len(self._calibration.ids)
        warmth = self._reading.temperature if same else np.full(n, np.nan)
        return Answer(shafts.position, joints.position, joints.velocity, joints.torque, warmth)

    def ask_more(self, tick: int) -> None:
        if tick >= self._next:
            self._next = tick + self._every
            self._reading.ask_more(moving=self._motors.on)

    def warnings(self) -> list[str]:
        return self._reading.warnings()

    def _fresh(self) -> None:
        """Forget the last session."""
        self._reading = Reading(self._sdk, self._calibration, self._names, self._settings.tries)
        self._next = self._every = self._settings.every(Reading.QUESTIONS * len(self._calibration.ids))
