"""What goes wrong with servos and their line: bytes by chance, the rest by script."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, TypeAlias, get_args

from allegro_twin.drivers.base.line_noise import Noise, Spoiler
from allegro_twin.drivers.dynamixel.virtual.servo import Servo
from allegro_twin.errors import ConfigError, unknown

Trouble: TypeAlias = Literal[
    "dead_motor", "torn_tendon", "watchdog", "other_id", "overheat", "overload", "silence", "power_cut", "recover"
]
TROUBLES: tuple[Trouble, ...] = get_args(Trouble)
OVERHEATED = 90.0
"""°C that a motor is set to: above what its servo bears."""
_OVERLOAD = 1 << 5
_WARM = 30.0  # °C.


class Event(NamedTuple):
    """Something that happens once."""

    at: float
    """s since the hand was switched on."""
    what: Trouble
    which: int = 0
    """The actuator; `power_cut` and `recover` are everybody's."""
    amount: float | None = None
    """`overheat`: °C; `other_id`: the id that it answers as, by default the highest."""


@dataclass(frozen=True)
class FaultPlan:
    """What is to go wrong. Raises ConfigError for what does not exist."""

    noise: Noise = field(default_factory=Noise)
    """Of the line, both ways."""
    script: tuple[Event, ...] = ()

    def __post_init__(self) -> None:
        for event in self.script:
            if event.what not in TROUBLES:
                raise ConfigError(f"faults.script: {unknown('fault', event.what, TROUBLES)}")


class Faults:
    """A plan at work on a hand's servos. Raises ConfigError for an event of a servo that is not there."""

    def __init__(self, plan: FaultPlan, servos: Sequence[Servo]) -> None:
        self.spoil = Spoiler(plan.noise)
        self._servos, self._ids = servos, [servo.id for servo in servos]
        self._script = sorted(plan.script, key=lambda event: event.at)
        self.heat = dict[int, float]()
        """Motors that are hot, °C."""
        self.torn = set[int]()
        """Actuators that their servo no longer pulls."""
        for event in plan.script:
            if not 0 <= event.which < len(servos):
                raise ConfigError(f"faults.script: which is {event.which}; this hand has {len(servos)} servos")

    def happen(self, now: float) -> None:
        """Let the events up to `now` happen."""
        while self._script and self._script[0].at <= now + 1e-9:
            self._do(self._script.pop(0))

    def _do(self, event: Event) -> None:
        servo = self._servos[event.which]
        match event.what:
            case "dead_motor":
                servo.dead = True
            case "torn_tendon":
                self.torn.add(event.which)
            case "watchdog":
                servo.trip()
            case "other_id":
                servo.become(252 if event.amount is None else int(event.amount))
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
