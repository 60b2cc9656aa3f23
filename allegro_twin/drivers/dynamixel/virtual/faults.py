"""Faults of virtual servos and their line: bytes by chance, the rest by script."""

from __future__ import annotations

from collections.abc import Sequence

from allegro_twin.drivers.base.faults import FaultScript, NoisyLine
from allegro_twin.drivers.dynamixel.config import ServoFaultEvent, ServoFaultSettings
from allegro_twin.drivers.dynamixel.virtual.servo import Servo

OVERHEATED = 90.0
"""°C that a motor is set to: above what its servo bears."""
_OVERLOAD = 1 << 5
_WARM = 30.0  # °C.
_HIGHEST_ID = 252


class ServoFaults:
    """Does to servos what a config's `faults` say. Raises ConfigError for an event of a servo that is not there."""

    def __init__(self, plan: ServoFaultSettings, servos: Sequence[Servo]) -> None:
        self.spoil = NoisyLine(plan)
        self._servos, self._ids = servos, [servo.id for servo in servos]
        self._script = FaultScript(plan.script, len(servos), "servos")
        self.heat = dict[int, float]()
        """Motors that are hot, °C."""
        self.torn = set[int]()
        """Actuators that their servo no longer pulls."""

    def happen(self, now: float) -> None:
        """Let the events up to `now` happen."""
        for event in self._script.take(now + 1e-9):
            self._do(event)

    def _do(self, event: ServoFaultEvent) -> None:
        servo = self._servos[event.which]
        match event.what:
            case "dead_motor":
                servo.dead = True
            case "torn_tendon":
                self.torn.add(event.which)
            case "watchdog":
                servo.trip()
            case "other_id":
                servo.become(_HIGHEST_ID if event.amount is None else int(event.amount))
            case "overheat":
                self.heat[event.which] = OVERHEATED if event.amount is None else event.amount
            case "overload":
                servo.fail(_OVERLOAD)
            case "silence":
                servo.mute = True
            case "power_cut":
                for each in self._servos:
                    each.reboot()
                    each.mute = True
            case "recover":
                self.heat = dict.fromkeys(self.heat, _WARM)
                self.torn.clear()
                for each, identifier in zip(self._servos, self._ids, strict=True):
                    each.dead = each.mute = False
                    each.become(identifier)
