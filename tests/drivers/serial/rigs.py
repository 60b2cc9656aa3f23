"""Small hands of servos: joints without MuJoCo, a line to them that a test can spoil, a program that serves them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest

from allegro_twin.app.config import RunConfig
from allegro_twin.app.rig import open_backend
from allegro_twin.backend import HandBackend, position_of
from allegro_twin.drivers.base.lockstep import LockstepLine
from allegro_twin.drivers.base.serial_line import SerialLine
from allegro_twin.drivers.base.serve import SerialDevice, serve
from allegro_twin.drivers.base.terminal import Terminal
from allegro_twin.drivers.dynamixel.codec.calibration import Calibration, Mounting
from allegro_twin.drivers.dynamixel.codec.table import XM430_W350, Model
from allegro_twin.drivers.dynamixel.config import DynamixelSettings, ServoFaultSettings
from allegro_twin.drivers.dynamixel.driver.backend import DynamixelBackend
from allegro_twin.drivers.dynamixel.driver.driver import ServoDriver
from allegro_twin.drivers.dynamixel.driver.host_settings import ServoHostSettings
from allegro_twin.drivers.dynamixel.virtual.hand import VirtualServoHand
from allegro_twin.files.schema import parse_settings
from allegro_twin.spec import Actuation, CommandKind, Finger, HandSpec
from allegro_twin.types import Command, HandState, PositionCommand, Vector, frozen
from tests.patience import comes_true

BAUD = 1_000_000
PERIOD = 0.01
MADE: list[HandBackend] = []
"""What a test has made and may not have closed."""
KT = 1.5
"""N·m/A of the servos here."""
LIMIT = 0.4
"""A."""


MODEL_O = {
    "model": "XM430-W350",
    "ids": [2, 1, 3, 4],
    "current_limit": [0.03, 1.5, 1.5, 1.5],
    "torque_per_ampere": 1.63,
}
"""Four servos on tendons; what the lab's report says of their currents."""


def config_of(hand: str = "leap", **backend: Any) -> RunConfig:
    """A virtual hand of servos with physics behind it."""
    block = {"kind": "dynamixel", "port": "virtual", "baud": 4_000_000} | backend
    content = {"hand": {"model": hand}, "backend": block, "controller": {"kind": "position"}, "period": 0.02}
    return parse_settings(RunConfig, content | {"seconds": 0.5}, "test")


def on_a_line(hand: str, **backend: Any) -> DynamixelBackend:
    """Its backend, without a guard."""
    pytest.importorskip("dynamixel_sdk", reason="pip install 'allegro-twin[dynamixel]'")
    config = config_of(hand, **backend)
    assert isinstance(config.backend, DynamixelSettings)
    made = open_backend(config)
    assert isinstance(made, DynamixelBackend)
    return made


def small_spec(n: int = 4, commands: tuple[CommandKind, ...] = ("position", "limited_position")) -> HandSpec:
    """A hand of one finger with so many joints."""
    ones = frozen(np.ones(n))
    names = tuple(f"joint_{k}" for k in range(n))
    actuation = Actuation(frozen(KT * LIMIT * np.ones(n)), ones, ones, ones)
    finger = Finger("index", tuple(range(n)), "tip")
    return HandSpec("small", "right", names, (finger,), frozen(-2.0 * ones), frozen(2.0 * ones), actuation, (),
                    commands=commands)  # fmt: skip


def calibrated(n: int = 4, model: Model = XM430_W350, **changed: object) -> Calibration:
    """Servos with ids from 3 up, every other one turned around, each with its own zero."""
    values = {"current_limit": LIMIT, "torque_per_ampere": KT} | changed
    servos = (Mounting(3 + k, direction=1 - 2 * (k % 2), zero=2048 + 10 * k, **values) for k in range(n))  # type: ignore[arg-type]  # What a test changes it knows.
    return Calibration(model, tuple(servos))


class Joints:
    """A HandBackend of joints with inertia and damping, each drawn to its goal by a spring of limited force."""

    inertia, damping, stiffness = 0.005, 0.15, 3.0
    steps = 10
    """Of integration, a period."""

    def __init__(self, spec: HandSpec, period: float = PERIOD) -> None:
        self.spec, self.period = spec, period
        self.written: list[PositionCommand] = []
        self.temperature = frozen(np.full(spec.n_joints, 30.0))
        self.closed = False

    def reset(self) -> HandState:
        n = self.spec.n_joints
        self._tick, self._q, self._v, self._torque = 0, np.zeros(n), np.zeros(n), np.zeros(n)
        self._command = PositionCommand(np.zeros(n), effort=np.zeros(n))
        return self._state()

    def write(self, command: Command) -> None:
        self._command = position_of(command, self.spec)
        self.written.append(self._command)

    def read(self) -> HandState:
        limit = self.spec.actuation.torque_limit if self._command.effort is None else self._command.effort
        dt = self.period / self.steps
        for _ in range(self.steps):
            self._torque = np.clip(self.stiffness * (self._command.position - self._q), -limit, limit)
            self._v = self._v + dt / self.inertia * (self._torque - self.damping * self._v)
            self._q = self._q + dt * self._v
        self._tick += 1
        return self._state()

    def close(self) -> None:
        self.closed = True

    def _state(self) -> HandState:
        t, gravity = self._tick * self.period, frozen(np.full(3, np.nan))
        return HandState(t, self._tick, frozen(self._q), frozen(self._v), frozen(self._torque),
                         self.temperature, gravity)  # fmt: skip


class Bench:
    """A virtual hand, the line to it inside this program, and the backend that drives it."""

    def __init__(
        self,
        n: int = 4,
        plan: ServoFaultSettings | None = None,
        *,
        settings: ServoHostSettings | None = None,
        baud: int = BAUD,
        servos_baud: int | None = None,
        there: Calibration | None = None,
        commands: tuple[CommandKind, ...] = ("position", "limited_position"),
        wrap: Callable[[SerialLine], SerialLine] = lambda port: port,
    ) -> None:
        """`there`: the servos that are there in truth."""
        self.joints = Joints(small_spec(n, commands))
        self.hand = VirtualServoHand(self.joints, there or calibrated(n), servos_baud or baud, plan=plan)
        self.opened = 0

        def opened() -> SerialLine:
            self.opened += 1
            return wrap(LockstepLine(self.hand, baud))

        self.open = opened
        self.calibration, self.settings = calibrated(n), settings or ServoHostSettings(period=PERIOD)
        self.backend = self.made()

    @property
    def driver(self) -> ServoDriver:
        driver = self.backend._driver
        assert isinstance(driver, ServoDriver)
        return driver

    def made(self) -> DynamixelBackend:
        made = DynamixelBackend(self.joints.spec, self.calibration, self.open, self.settings)
        MADE.append(made)
        return made

    def go(self, position: float | Vector, periods: int = 1, effort: float | None = None) -> HandState:
        """Go there for so many periods; the last state."""
        n = self.joints.spec.n_actuators
        for _ in range(periods):
            limit = None if effort is None else np.full(n, effort)
            self.backend.write(PositionCommand(np.broadcast_to(position, n), effort=limit))
            state = self.backend.read()
        return state


class Serving:
    """A hand served in real time at a terminal by a thread, which ends with the block."""

    def __init__(self, path: Path, hand: SerialDevice) -> None:
        self.hand, self.terminal = hand, Terminal(path)
        self.error: Exception | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self.terminal.close()
        assert self.error is None

    def _serve(self) -> None:
        try:
            for _ in serve(self.hand, self.terminal):
                if self._over.is_set():
                    return
        except Exception as error:  # noqa: BLE001  # It is raised where the block ends.
            self.error = error


def soon(true: Callable[[], bool], seconds: float = 20.0) -> bool:
    """Whether it comes true in time."""
    return comes_true(true, seconds)
