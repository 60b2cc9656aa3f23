"""Settings of the host's side of a hand of servos."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from allegro_twin.drivers.base.host_settings import SerialHostSettings
from allegro_twin.errors import ConfigError


@dataclass(frozen=True, slots=True)
class ServoHostSettings(SerialHostSettings):
    """Raises ConfigError for times that none can keep."""

    LONGEST: ClassVar[int] = 127  # ROBOTIS e-Manual, Bus Watchdog.

    temperature_period: float = 4.0
    """s in which every servo is asked once for its temperature."""
    return_delay: int = 0
    """What Return Delay Time is set to, 2 µs each; servos come with 250."""

    def __post_init__(self) -> None:
        SerialHostSettings.__post_init__(self)
        if not 0 <= self.return_delay <= 254:
            raise ConfigError(f"return_delay must be 0 to 254, not {self.return_delay}")

    def every(self, questions: int) -> int:
        """Periods between two of so many questions that are asked slowly, in turn."""
        return max(int(self.temperature_period / questions / self.period), 1)
