"""A hand that answers when it is asked: rad and N·m on this side, ticks and milliamperes on the wire's."""

from __future__ import annotations

from typing import Any

import numpy as np

from allegro_twin.drivers.base.driver import Answer
from allegro_twin.drivers.polled.exchange import Exchange
from allegro_twin.drivers.polled.scale import Scale
from allegro_twin.drivers.polled.wire import MotorState, Wire
from allegro_twin.errors import ConfigError, HandFault, LinkError, ProtocolError
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector, frozen

_FAR = 0.25
"""Share of its range outside of which an actuator cannot be."""
_TRIES = 3


class PolledDriver:
    """`wire` speaks the hand's language through `exchange`."""

    def __init__(self, spec: HandSpec, scale: Scale, exchange: Exchange, wire: Wire) -> None:
        self._spec, self._scale, self._exchange, self._wire = spec, scale, exchange, wire
        self._unknown = frozen(np.full(spec.n_joints, np.nan))
        self.on = False

    @property
    def calibration(self) -> dict[str, Any]:
        return self._scale.described()

    @property
    def shutdown_frames(self) -> bytes:
        return self._wire.shutdown_frames

    def find(self) -> None:
        self._wire.find()

    def wake(self) -> None:
        """It has nothing to be set."""

    def first(self) -> Answer:
        return self.ask()

    def go(self, position: Vector, effort: Vector | None) -> None:
        self.on = True
        self._wire.go(self._scale.ticks(position))

    def again(self, position: Vector) -> None:
        self.go(position, None)

    def stop(self) -> None:
        for left in reversed(range(_TRIES)):
            try:
                self._wire.stop()
                break
            except (LinkError, ProtocolError):
                if not left:
                    raise
        self.on = False

    def ask(self) -> Answer:
        motors = self._wire.ask()
        position = self._scale.position(motors.ticks)
        self._check(motors, position)
        return Answer(position, position, motors.when, self._scale.torque(motors.current), self._unknown)

    def ask_more(self, tick: int) -> None:
        """All is in every answer."""

    def warnings(self) -> list[str]:
        return self._exchange.warnings()

    def _check(self, motors: MotorState, position: Vector) -> None:
        """Raises HandFault for what the hand says of itself, ConfigError for a place where it cannot be."""
        if motors.why:
            raise HandFault(f"{self._spec.name}: {motors.why}; reset to go on")
        if self.on and not motors.on:
            raise HandFault(f"{self._spec.name} has switched its motors off: it lost its power; reset to go on")
        spec = self._spec
        excess = np.maximum(spec.lower - position, position - spec.upper) / (spec.upper - spec.lower)
        worst = int(np.argmax(excess))
        if excess[worst] > _FAR:
            where = f"{position[worst]:.2f} rad, far outside [{spec.lower[worst]:.2f}, {spec.upper[worst]:.2f}]"
            raise ConfigError(f"{spec.joint_labels[worst]} would be at {where}: its zero is wrong, or it lost a turn")
