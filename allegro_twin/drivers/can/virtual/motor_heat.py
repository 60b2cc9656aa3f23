"""Motor heating of a virtual hand.

How fast they warm is of the hand's description (`thermal`). What the firmware does about it is assumed, as that is:
throttling and faults happen for the right reason, not at the right time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from allegro_twin.spec.thermal import AMBIENT, ThermalData
from allegro_twin.types import Vector

THROTTLE = 70.0  # °C from which the firmware gives less torque. Assumed; the guard fades from 60 °C on.
EVERY = 0.1  # s between two updates.
FAULT = 85.0  # °C at which it gives none. Assumed.


class MotorHeat:
    """First-order heating by the losses of a torque, ten times a second: T' = (T_a + ΔT mean(τ²)/τ_max² − T) / t."""

    def __init__(self, full: Vector, thermal: ThermalData, period: float) -> None:
        """`full`: the torque that each can give, (n,), N·m; `period`: s of a step."""
        self._rise, self._time_constant = thermal.rise / np.square(full), thermal.time_constant
        self.temperature: Vector = np.full(len(full), AMBIENT)
        """°C, (n,)."""
        self.share: Vector = np.ones(len(full))
        """How much of a wanted torque each motor gives, (n,), 0 … 1."""
        self.cold = True
        """Whether every motor gives all of it."""
        self.steps, self._seconds = 0, 0.0
        """Between two updates."""
        while self._seconds < EVERY:
            self.steps, self._seconds = self.steps + 1, self._seconds + period

    def warm(self, torques: Sequence[Vector]) -> None:
        """Let the torques of `steps` steps act, (n,) each, N·m."""
        goal = AMBIENT + self._rise * np.square(torques).sum(axis=0) / len(torques)
        self.temperature += (goal - self.temperature) * (1.0 - math.exp(-self._seconds / self._time_constant))
        self.share = np.clip((FAULT - self.temperature) / (FAULT - THROTTLE), 0.0, 1.0)
        self.cold = bool((self.share == 1.0).all())
