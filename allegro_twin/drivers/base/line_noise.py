"""Bytes that get lost or garbled on their way, by chance with a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from allegro_twin.errors import ConfigError


@dataclass(frozen=True)
class Noise:
    """Probabilities, per byte. Raises ConfigError for what is none."""

    lose: float = 0.0
    garble: float = 0.0
    """A bit turned over."""
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("lose", "garble"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ConfigError(f"faults.{name} must be a probability from 0 to 1, not {getattr(self, name)}")


class Spoiler:
    """A noise at work."""

    def __init__(self, noise: Noise) -> None:
        self._noise, self._rng = noise, np.random.default_rng(noise.seed)

    def __call__(self, data: bytes) -> bytes:
        """What arrives of these bytes."""
        noise, rng = self._noise, self._rng
        if not data or not (noise.lose or noise.garble):
            return data
        arrived = np.frombuffer(data, np.uint8)
        hit = rng.random(len(arrived)) < noise.garble
        arrived = arrived ^ (hit << rng.integers(8, size=len(arrived))).astype(np.uint8)
        return arrived[rng.random(len(arrived)) >= noise.lose].tobytes()
