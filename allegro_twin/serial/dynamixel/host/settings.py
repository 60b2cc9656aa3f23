"""How to deal with a hand of servos."""

from __future__ import annotations

import math
from dataclasses import dataclass

from allegro_twin.errors import ConfigError
from allegro_twin.serial.dynamixel.codec.table import WATCHDOG_UNIT


@dataclass(frozen=True, slots=True)
class HostSettings:
    """How to deal with a hand of servos. Raises ConfigError for times that none can keep."""

    period: float = 0.01
    """s between two states."""
    watchdog: float = 0.2
    """s without a word from the program after which the servos stop by themselves, in steps of 0.02 s."""
    tries: int = 3
    """How often a state is asked for before the hand counts as silent."""
    temperature_period: float = 4.0
    """s in which every servo is asked once for its temperature."""
    keeper: bool = True
    """Have a process of its own switch the motors off when the program dies; where the line can be shared."""
    return_delay: int = 0
    """What Return Delay Time is set to, 2 µs each; servos come with 250."""

    def __post_init__(self) -> None:
        if not 0.0 < self.period < math.inf:
            raise ConfigError(f"period must be a number of seconds above 0, not {self.period}")
        if not 1 <= self.watchdog_counts <= 127 or self.watchdog < 2 * self.period:
            raise ConfigError(
                f"watchdog {self.watchdog:g} s must be from {WATCHDOG_UNIT:g} to {127 * WATCHDOG_UNIT:g} s, and two "
                f"periods of {self.period:g} s or more"
            )
        if self.tries < 1 or not 0 <= self.return_delay <= 254:
            raise ConfigError(
                f"tries must be 1 or more and return_delay 0 to 254, not {self.tries}, {self.return_delay}"
            )

    def every(self, questions: int) -> int:
        """Periods between two of so many questions that are asked slowly, in turn."""
        return max(int(self.temperature_period / questions / self.period), 1)

    @property
    def watchdog_counts(self) -> int:
        """In the servos' steps, rounded up."""
        return math.ceil(self.watchdog / WATCHDOG_UNIT - 1e-9)
