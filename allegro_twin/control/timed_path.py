"""A path through joint positions that somebody else has timed."""

from __future__ import annotations

import numpy as np

from allegro_twin.control.trajectory import SetPoint
from allegro_twin.types import Array, Vector, frozen


class Timed:
    """Through postures at times. Without velocities in straight lines; with them on cubics that have them,

    q(s) = h₀₀ a + h₁₀ T ȧ + h₀₁ b + h₁₁ T ḃ        s = (t - t_a) / T, Hermite's h
    """

    def __init__(self, times: Vector, postures: Array, velocities: Array | None = None) -> None:
        """`times`: ascending from 0, (k,), s; `postures` and `velocities`: (k, n), rad and rad/s."""
        self.times, self.postures, self.velocities = times, postures, velocities
        self._rest = SetPoint(frozen(postures[-1]), frozen(np.zeros_like(postures[-1])))

    @property
    def seconds(self) -> float:
        """When the last posture is reached."""
        return float(self.times[-1])

    def __call__(self, t: float) -> SetPoint:
        if t >= self.times[-1]:
            return self._rest
        leg = max(int(np.searchsorted(self.times, t, side="right")) - 1, 0)
        begin, span = self.times[leg], self.times[leg + 1] - self.times[leg]
        a, b, s = self.postures[leg], self.postures[leg + 1], (t - begin) / span
        if self.velocities is None:
            return SetPoint(frozen(a + s * (b - a)), frozen((b - a) / span))
        va, vb = span * self.velocities[leg], span * self.velocities[leg + 1]
        at = (1 + 2 * s) * (1 - s) ** 2 * a + s * (1 - s) ** 2 * va + s**2 * (3 - 2 * s) * b + s**2 * (s - 1) * vb
        rate = 6 * s * (1 - s) * (b - a) + (1 - s) * (1 - 3 * s) * va + s * (3 * s - 2) * vb
        return SetPoint(frozen(at), frozen(rate / span))
