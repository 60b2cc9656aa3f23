"""Bus budget: the cost of a period on the bus, and the periods that it can carry."""

from __future__ import annotations

from typing import NamedTuple

from allegro_twin.drivers.base.serial_line import BITS
from allegro_twin.drivers.dynamixel.codec.packet import FRAME
from allegro_twin.errors import ConfigError

DELAY_UNIT = 2e-6
"""s of Return Delay Time."""
GOAL, PRESENT = 4, 10
"""Bytes a servo: of Goal Position; of current, velocity and position together."""
CURRENT = 2
"""Bytes a servo: of Goal Current."""


class Budget(NamedTuple):
    """One period: the goals go out, everybody answers."""

    servos: int
    baud: int
    size: int
    """Bytes on the line."""
    seconds: float

    @property
    def rate(self) -> float:
        """Periods a second, at best."""
        return 1.0 / self.seconds


def budget(servos: int, baud: int, return_delay: int = 0, *, limited: bool = False) -> Budget:
    """Bus budget of a hand with so many servos. `return_delay`: as it stands in the servos, 2 µs each; `limited`: every
    period also sends the current limits."""
    out = FRAME + 4 + servos * (1 + GOAL)
    if limited:
        out += FRAME + 4 + servos * (1 + CURRENT)
    size = out + FRAME + 4 + servos + servos * (FRAME + 1 + PRESENT)
    return Budget(servos, baud, size, size * BITS / baud + servos * return_delay * DELAY_UNIT)


def check(period: float, need: Budget) -> None:
    """Raises ConfigError for a period that the bus cannot carry."""
    if period < need.seconds:
        raise ConfigError(
            f"period {period:g} s is too short for {need.servos} servos at {need.baud} baud: {need.size} bytes take "
            f"{need.seconds:.5f} s; raise baud (in the servos, too) or the period"
        )
