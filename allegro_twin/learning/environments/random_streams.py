"""Random numbers for a batch: each simulation's own, the same whatever the size of the batch it stands in.

What is drawn at a reset comes from the simulation's generator in one call. What is drawn at every period is computed
from a key and a counter (splitmix64, Steele et al. 2014), so that no loop runs over the simulations.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.array_api import array_namespace
from allegro_twin.types import Array

_STREAM = 15  # Of the numbers that resets draw by count.
COLUMNS = 64
"""Uniform numbers that a reset draws, whatever it uses of them: so an option does not shift what comes after it."""


class Draws:
    """What some simulations drew at a reset: uniform numbers, dealt column by column."""

    def __init__(self, uniform: Array) -> None:
        """`uniform`: in [0, 1), (m, COLUMNS)."""
        self._uniform, self._xp = uniform, array_namespace(uniform)
        self._next = 0

    @classmethod
    def of(cls, generators: list[np.random.Generator], xp: Any = np) -> Draws:
        """From each simulation's own generator, in one call."""
        return cls(xp.double(np.stack([generator.random(COLUMNS) for generator in generators])))

    @classmethod
    def counted(cls, key: NDArray[np.uint64], episode: NDArray[np.int64]) -> Draws:
        """From each simulation's key (m,) and the number of its episode (m,): without a loop over simulations."""
        return cls((_even(key, episode, _STREAM, COLUMNS) + 1.0) / 2.0)

    def __len__(self) -> int:
        return len(self._uniform)

    def within(self, low: float, high: float, count: int = 1) -> Array:
        """Uniform in [low, high), shape (m, count)."""
        columns = self._uniform[:, self._next : self._next + count]
        self._next += count
        found: Array = self._xp.asarray(low + (high - low) * columns, np.float64)
        return found

    def number(self, below: int) -> NDArray[np.int64]:
        """One of 0 … below - 1, shape (m,)."""
        xp = self._xp
        chosen: NDArray[np.int64] = xp.minimum(xp.asarray(self.within(0.0, 1.0)[:, 0] * below, np.int64), below - 1)
        return chosen

    def whole(self, low: float, high: float) -> Array:
        """One of low … high, both included, shape (m, 1)."""
        found: Array = self._xp.minimum(self._xp.floor(self.within(low, high + 1)), high)
        return found

    def signs(self, count: int) -> Array:
        """-1 or 1, shape (m, count)."""
        found: Array = self._xp.where(self.within(-1.0, 1.0, count) < 0, -1.0, 1.0)
        return found

    def direction(self) -> Array:
        """A unit vector, uniform over the sphere, shape (m, 3)."""
        z, turn = self.within(-1.0, 1.0)[:, 0], self.within(0.0, 2 * np.pi)[:, 0]
        xp = self._xp
        radius = xp.sqrt(xp.maximum(1.0 - z * z, 0.0))
        found: Array = xp.stack([radius * xp.cos(turn), radius * xp.sin(turn), z], axis=-1)
        return found

    def key(self) -> NDArray[np.uint64]:
        """For `jitter`, shape (m,)."""
        self._next += 1
        found: NDArray[np.uint64] = self._xp.asarray(self._uniform[:, self._next - 1] * 2.0**53, np.uint64)
        return found


def jitter(key: NDArray[np.uint64], counter: NDArray[np.int64], stream: int, count: int) -> Array:
    """Uniform in [-1, 1), shape (n, count): the numbers of each key (n,) at its own counter (n,)."""
    found: Array = array_namespace(key).asarray(_even(key, counter, stream, count), np.float64)
    return found


_STEP, _FIRST, _SECOND = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB


def _mixed(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    x = x + np.uint64(_STEP)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(_FIRST)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(_SECOND)
    return x ^ (x >> np.uint64(31))


def _even(key: Any, counter: Any, stream: int, count: int) -> Any:
    """The numbers of `jitter` in double precision. PyTorch's whole numbers have a sign, and overflow likewise."""
    if isinstance(key, np.ndarray):
        column = np.arange(count, dtype=np.uint64) + np.uint64(stream * 1024)
        seed = key * np.uint64(_STEP) + counter.astype(np.uint64)
        mixed = _mixed(_mixed(seed)[:, None] + column)
        return (mixed >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1.0
    column = array_namespace(key).arange(count) + stream * 1024
    mixed = _mixed_signed(_mixed_signed(key * _signed(_STEP) + counter)[:, None] + column)
    return _shifted(mixed, 11).double() * 2.0**-52 - 1.0


def _mixed_signed(x: Any) -> Any:
    x = x + _signed(_STEP)
    x = (x ^ _shifted(x, 30)) * _signed(_FIRST)
    x = (x ^ _shifted(x, 27)) * _signed(_SECOND)
    return x ^ _shifted(x, 31)


def _shifted(x: Any, by: int) -> Any:
    """To the right, zeros coming in."""
    return (x >> by) & ((1 << (64 - by)) - 1)


def _signed(x: int) -> int:
    return x - 2**64
