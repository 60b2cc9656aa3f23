"""Frozen encoders: reports of a joint that repeat to the last bit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

RESTLESS, LOOKED = 0.3, 100
"""Share of periods of a slow joint in which its reports differ from the last, above which they are noisy: those of a
coarse encoder repeat, 0.9 and more of them. Periods that tell."""


class RepeatedReports:
    """Counts how often joints report the same to the last bit. An encoder whose reports were noisy and repeat for long
    is frozen, whatever its finger does."""

    def __init__(self, n: int) -> None:
        self._run, self._slow, self._of, self._other = (np.zeros(n, dtype=int) for _ in range(4))

    def add(self, same: NDArray[np.bool_], heard: NDArray[np.bool_], slow: NDArray[np.bool_]) -> None:
        """Add a period: whether each joint reports the same as before, whether it reports, and whether it is slow."""
        new, slow = heard & ~same, heard & slow
        self._slow, self._other = self._slow + slow, self._other + (new & slow)
        self._run = np.where(new, 0, self._run + (heard & same))
        self._of = np.where(new, 0, self._of + (slow & same))  # Periods of the present run among the slow ones.

    def lasting(self, periods: int) -> NDArray[np.bool_]:
        """Joints that have reported the same for so many periods, (n,)."""
        return np.asarray(self._run >= periods)

    def frozen(self, periods: int) -> NDArray[np.bool_]:
        """Joints with noisy reports that have repeated for so many periods, (n,)."""
        looked = self._slow - self._of
        return self.lasting(periods) & (looked >= LOOKED) & (self._other > RESTLESS * looked)
