"""Settings of the host's side of a hand that answers requests."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from allegro_twin.drivers.base.host_settings import SerialHostSettings
from allegro_twin.drivers.base.serial_line import LATENCY
from allegro_twin.errors import ConfigError


@dataclass(frozen=True, slots=True)
class PolledHostSettings(SerialHostSettings):
    """Raises ConfigError for times that none can keep."""

    LONGEST: ClassVar[int] = 250  # qbAPI: 500 centiseconds.

    latency: float = LATENCY
    """s that an answer may take beside its bytes."""

    def __post_init__(self) -> None:
        SerialHostSettings.__post_init__(self)
        if not 0.0 < self.latency < math.inf:
            raise ConfigError(f"latency must be above 0 s, not {self.latency:g}")
