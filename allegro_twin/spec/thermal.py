"""Thermal data of a hand's motors: how warm they become, and how fast, by what they give."""

from __future__ import annotations

import math
from dataclasses import dataclass

AMBIENT = 25.0
"""°C of the room in which a motor begins."""


@dataclass(frozen=True, slots=True)
class ThermalData:
    """First-order heating by the losses of a torque: T' = (T_a + ΔT (τ/τ_max)² − T) / t."""

    rise: float
    """ΔT: K above the room that full effort leads to in the end."""
    time_constant: float
    """t, s."""
    source: str
    """Where the two are from."""

    def seconds_until(self, celsius: float, share: float) -> float:
        """How long a motor at `AMBIENT` may give a share of its full effort until it has a temperature, s; inf where
        it never has: t ln(1 / (1 − (T − T_a) / (ΔT share²)))."""
        rise = self.rise * share * share
        part = (celsius - AMBIENT) / rise if rise > 0.0 else math.inf
        return -self.time_constant * math.log1p(-part) if part < 1.0 else math.inf
