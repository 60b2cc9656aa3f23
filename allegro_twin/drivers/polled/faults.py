"""What goes wrong with such a hand and its line: bytes by chance, the rest by script."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple, TypeAlias, get_args

from allegro_twin.drivers.base.line_noise import Noise
from allegro_twin.errors import ConfigError, unknown

Trouble: TypeAlias = Literal["dead_motor", "torn_tendon", "silence", "power_cut", "recover"]
TROUBLES: tuple[Trouble, ...] = get_args(Trouble)


class Event(NamedTuple):
    """Something that happens once."""

    at: float
    """s since the hand was switched on."""
    what: Trouble
    which: int = 0
    """The actuator, of `dead_motor` and `torn_tendon`; the others are the whole hand's."""


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
