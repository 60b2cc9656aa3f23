"""How to deal with such a hand."""

from __future__ import annotations

import math
from dataclasses import dataclass

from allegro_twin.errors import ConfigError
from allegro_twin.serial.line.port import LATENCY

WATCHDOG_UNIT = 0.02
"""s: the steps in which the hands here count. Of a qb device: its firmware's cmd_set_watchdog, 2 centiseconds."""
_LONGEST = 250
"""Of these steps. qbAPI: 500 centiseconds."""


@dataclass(frozen=True, slots=True)
class HostSettings:
    """Raises ConfigError for times that none can keep."""

    period: float = 0.01
    """s between two states."""
    watchdog: float = 0.2
    """s without a word from the program after which the hand lets go by itself, in steps of 0.02 s."""
    latency: float = LATENCY
    """s that an answer may take beside its bytes."""
    tries: int = 3
    """How often the hand is asked before it counts as silent."""
    keeper: bool = True
    """Have a process of its own switch the motors off when the program dies; where the line can be shared."""

    def __post_init__(self) -> None:
        if not 0.0 < self.period < math.inf:
            raise ConfigError(f"period must be a number of seconds above 0, not {self.period}")
        if not 1 <= self.watchdog_counts <= _LONGEST or self.watchdog < 2 * self.period:
            raise ConfigError(
                f"watchdog {self.watchdog:g} s must be from {WATCHDOG_UNIT:g} to {_LONGEST * WATCHDOG_UNIT:g} s, and "
                f"two periods of {self.period:g} s or more"
            )
        if self.tries < 1 or not 0.0 < self.latency < math.inf:
            raise ConfigError(f"tries must be 1 or more and latency above 0 s, not {self.tries}, {self.latency:g}")

    @property
    def watchdog_counts(self) -> int:
        """In the hand's steps, rounded up."""
        return math.ceil(self.watchdog / WATCHDOG_UNIT - 1e-9)
