"""Random numbers for a batch: each simulation's own, the same whatever the size of the batch it stands in.

What is drawn at a reset comes from the simulation's generator in one call. What is drawn at every period is computed
from a key and a counter (splitmix64, Steele et al. 2014), so that no loop runs over the simulations.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from allegro_twin.types import Array

COLUMNS = 64
"""Uniform numbers that a reset draws, whatever it uses of them: so an option does not shift what comes after it."""


class Draws:
    """What some simulations drew at a reset: uniform numbers, dealt column by column."""

    def __init__(self, generators: list[np.random.Generator]) -> None:
        self._uniform = np.stack([generator.random(COLUMNS) for generator in generators])
        self._next = 0

    def __len__(self) -> int:
        return len(self._uniform)

    def within(self, low: float, high: float, count: int = 1) -> Array:
        """Uniform in [low, high), shape (m, count)."""
        columns = self._uniform[:, self._next : self._next + count]
        self._next += count
        return low + (high - low) * columns

    def number(self, below: int) -> NDArray[np.int64]:
        """One of 0 … below - 1, shape (m,)."""
        return np.minimum((self.within(0.0, 1.0)[:, 0] * below).astype(np.int64), below - 1)

    def direction(self) -> Array:
        """A unit vector, uniform over the sphere, shape (m, 3)."""
        z, turn = self.within(-1.0, 1.0)[:, 0], self.within(0.0, 2 * np.pi)[:, 0]
        radius = np.sqrt(np.maximum(1.0 - z * z, 0.0))
        return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=-1)

    def key(self) -> NDArray[np.uint64]:
        """For `jitter`, shape (m,)."""
        return (self.within(0.0, 1.0)[:, 0] * 2.0**53).astype(np.uint64)


def jitter(key: NDArray[np.uint64], counter: NDArray[np.int64], stream: int, count: int) -> Array:
    """Uniform in [-1, 1), shape (n, count): the numbers of each key (n,) at its own counter (n,)."""
    column = np.arange(count, dtype=np.uint64) + np.uint64(stream * 1024)
    seed = key * np.uint64(0x9E3779B97F4A7C15) + counter.astype(np.uint64)
    mixed = _mixed(_mixed(seed)[:, None] + column)
    return (mixed >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1.0


def _mixed(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))
