"""Scales of encoder ticks and motor currents, the same at both ends of the wire."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector, frozen


@dataclass(frozen=True, eq=False)
class Scale:
    """Scales of all actuators of a hand, arrays of shape (m,)."""

    lower: Vector
    """Position at tick 0, rad."""
    per_tick: Vector
    """rad."""
    per_milliampere: Vector
    """N·m."""
    most: int
    """The highest tick that can be asked for; the lowest is 0."""

    @classmethod
    def of(cls, spec: HandSpec, ticks: int, per_ampere: float | list[float]) -> Scale:
        """From the lowest position to the highest in so many ticks; N·m/A. Raises ConfigError."""
        n = spec.n_actuators
        row = frozen(np.broadcast_to(per_ampere, n) if isinstance(per_ampere, float) else per_ampere)
        if row.shape != (n,) or not (row > 0.0).all():
            raise ConfigError(f"torque_per_ampere needs one number above 0 or {n}, N·m/A, not {per_ampere}")
        return cls(spec.lower, frozen((spec.upper - spec.lower) / ticks), frozen(1e-3 * row), ticks)

    def position(self, ticks: Array) -> Vector:
        """rad."""
        return self.lower + ticks * self.per_tick

    def ticks(self, position: Vector) -> list[int]:
        """To the nearest; no farther than can be asked for."""
        ticks = np.rint((position - self.lower) / self.per_tick)
        found: list[int] = np.minimum(np.maximum(ticks, 0), self.most).astype(int).tolist()
        return found

    def torque(self, milliamperes: Array) -> Vector:
        """N·m."""
        return milliamperes * self.per_milliampere

    def described(self) -> dict[str, Any]:
        """As plain data, for recordings."""
        rows = {"lower": self.lower, "per_tick": self.per_tick, "per_milliampere": self.per_milliampere}
        return {name: row.tolist() for name, row in rows.items()} | {"most": self.most}
