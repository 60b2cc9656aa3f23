"""Settings of the host's side of a serial line."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from allegro_twin.errors import ConfigError

VIRTUAL_PORT = "virtual"
"""The port that is a line inside this program."""
WATCHDOG_UNIT = 0.02
"""s: the steps in which the hands here count: DYNAMIXEL's Bus Watchdog, and a qb device's cmd_set_watchdog."""


@dataclass(frozen=True, slots=True)
class SerialHostSettings:
    """Raises ConfigError for times that none can keep."""

    LONGEST: ClassVar[int]
    """A watchdog's most steps."""

    period: float = 0.01
    """s between two states."""
    watchdog: float = 0.2
    """s without a word from the program after which the hand lets go by itself, in steps of 0.02 s."""
    tries: int = 3
    """How often the hand is asked before it counts as silent."""
    keeper: bool = True
    """Have a process of its own switch the motors off when the program dies; where the line can be shared."""

    def __post_init__(self) -> None:
        if not 0.0 < self.period < math.inf:
            raise ConfigError(f"period must be a number of seconds above 0, not {self.period}")
        if not 1 <= self.watchdog_counts <= self.LONGEST or self.watchdog < 2 * self.period:
            most = self.LONGEST * WATCHDOG_UNIT
            raise ConfigError(
                f"watchdog {self.watchdog:g} s must be from {WATCHDOG_UNIT:g} to {most:g} s, and two periods of "
                f"{self.period:g} s or more"
            )
        if self.tries < 1:
            raise ConfigError(f"tries must be 1 or more, not {self.tries}")

    @property
    def watchdog_counts(self) -> int:
        """In the hand's steps, rounded up."""
        return math.ceil(self.watchdog / WATCHDOG_UNIT - 1e-9)
