"""Demonstration: states of a hand that somebody guides by hand."""

from __future__ import annotations

import numpy as np

from allegro_twin.control.demonstration import TaughtMotion, trim_demonstration
from allegro_twin.errors import ConfigError
from allegro_twin.spec import HandSpec
from allegro_twin.spec.hand import GIVE
from allegro_twin.types import Array, Sample, Vector


class Demonstration:
    """Keeps every sample of what a person shows."""

    def __init__(self, spec: HandSpec) -> None:
        self._spec = spec
        self._rows: list[tuple[float, Vector]] = []

    def __call__(self, sample: Sample) -> None:
        self._rows.append((sample.state.t, sample.state.position))

    def posture(self) -> Vector:
        """Where the fingers were left, (n,), rad."""
        if not self._rows:
            raise ConfigError("nothing was taught: no time has passed in the demonstration; hand.wait(seconds) lets it")
        return self._inside(self._rows[-1][1])

    def motion(self, tolerance: float = 0.004) -> TaughtMotion:
        """The way they went, trimmed and simplified to within `tolerance` (rad)."""
        self.posture()
        times, positions = zip(*self._rows, strict=True)
        return trim_demonstration(np.array(times), self._inside(np.array(positions)), tolerance=tolerance)

    def _inside(self, positions: Array) -> Array:
        """A joint that leans on its stop gives a little; what is taught ends at the limit. Anything further beyond it
        stays, and is refused by whoever is asked to repeat it."""
        inside: Array = np.clip(positions, self._spec.lower, self._spec.upper)
        return np.where(np.abs(inside - positions) <= GIVE, inside, positions)
