"""Random numbers of a batch: each simulation has its own, the same for any size of the batch.

Numbers of a reset come from the simulation's generator in one call. Numbers of every period are computed from a key and
a counter (splitmix64, Steele et al. 2014), without a loop over the simulations.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.array_api import array_namespace
from allegro_twin.types import Array

_STREAM = 15  # Stream of the numbers that resets draw by counter.
COLUMNS = 64
"""Uniform numbers that a reset draws, whether it uses them or not: so an option does not shift those after it."""


class Draws:
    """Random numbers of a reset of some simulations: uniform numbers, used column by column."""

    def __init__(self, uniform: Array) -> None:
        """`uniform`: in [0, 1), (m, COLUMNS)."""
        self._uniform, self._xp = uniform, array_namespace(uniform)
        self._next = 0

    @classmethod
    def from_generators(cls, generators: list[np.random.Generator], xp: Any = np) -> Draws:
        """Draw from each simulation's own generator, in one call."""
        return cls(xp.double(np.stack([generator.random(COLUMNS) for generator in generators])))

    @classmethod
    def from_counters(cls, key: NDArray[np.uint64], episode: NDArray[np.int64]) -> Draws:
        """Compute from each simulation's key (m,) and the number of its episode (m,), without a loop."""
        return cls((_uniform_numbers(key, episode, _STREAM, COLUMNS) + 1.0) / 2.0)

    def __len__(self) -> int:
        return len(self._uniform)

    def uniform(self, low: float, high: float, count: int = 1) -> Array:
        """Uniform in [low, high), shape (m, count)."""
        columns = self._uniform[:, self._next : self._next + count]
        self._next += count
        found: Array = self._xp.asarray(low + (high - low) * columns, np.float64)
        return found

    def integers(self, below: int) -> NDArray[np.int64]:
        """Integers 0 … below - 1, shape (m,)."""
        xp = self._xp
        chosen: NDArray[np.int64] = xp.minimum(xp.asarray(self.uniform(0.0, 1.0)[:, 0] * below, np.int64), below - 1)
        return chosen

    def integers_between(self, low: float, high: float) -> Array:
        """Integers low … high, both included, shape (m, 1)."""
        found: Array = self._xp.minimum(self._xp.floor(self.uniform(low, high + 1)), high)
        return found

    def signs(self, count: int) -> Array:
        """-1 or 1, shape (m, count)."""
        found: Array = self._xp.where(self.uniform(-1.0, 1.0, count) < 0, -1.0, 1.0)
        return found

    def directions(self) -> Array:
        """Unit vectors, uniform over the sphere, shape (m, 3)."""
        z, turn = self.uniform(-1.0, 1.0)[:, 0], self.uniform(0.0, 2 * np.pi)[:, 0]
        xp = self._xp
        radius = xp.sqrt(xp.maximum(1.0 - z * z, 0.0))
        found: Array = xp.stack([radius * xp.cos(turn), radius * xp.sin(turn), z], axis=-1)
        return found

    def keys(self) -> NDArray[np.uint64]:
        """Keys for `jitter`, shape (m,)."""
        self._next += 1
        return self._keys_of(self._next - 1)

    def last_keys(self) -> NDArray[np.uint64]:
        """Keys likewise, of the last column, which no other draw reaches: whoever takes them shifts no other."""
        return self._keys_of(COLUMNS - 1)

    def _keys_of(self, column: int) -> NDArray[np.uint64]:
        found: NDArray[np.uint64] = self._xp.asarray(self._uniform[:, column] * 2.0**53, np.uint64)
        return found


def jitter(key: NDArray[np.uint64], counter: NDArray[np.int64], stream: int, count: int) -> Array:
    """Uniform in [-1, 1), shape (n, count): the numbers of each key (n,) at its own counter (n,)."""
    found: Array = array_namespace(key).asarray(_uniform_numbers(key, counter, stream, count), np.float64)
    return found


_STEP, _FIRST, _SECOND = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB


def _mix(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    x = x + np.uint64(_STEP)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(_FIRST)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(_SECOND)
    return x ^ (x >> np.uint64(31))


def _uniform_numbers(key: Any, counter: Any, stream: int, count: int) -> Any:
    """The numbers of `jitter` in double precision. PyTorch's integers are signed and overflow in the same way."""
    if isinstance(key, np.ndarray):
        column = np.arange(count, dtype=np.uint64) + np.uint64(stream * 1024)
        seed = key * np.uint64(_STEP) + counter.astype(np.uint64)
        mixed = _mix(_mix(seed)[:, None] + column)
        return (mixed >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1.0
    column = array_namespace(key).arange(count) + stream * 1024
    mixed = _mix_signed(_mix_signed(key * _to_signed(_STEP) + counter)[:, None] + column)
    return _shift_right(mixed, 11).double() * 2.0**-52 - 1.0


def _mix_signed(x: Any) -> Any:
    x = x + _to_signed(_STEP)
    x = (x ^ _shift_right(x, 30)) * _to_signed(_FIRST)
    x = (x ^ _shift_right(x, 27)) * _to_signed(_SECOND)
    return x ^ _shift_right(x, 31)


def _shift_right(x: Any, by: int) -> Any:
    """Shift right, with zeros coming in."""
    return (x >> by) & ((1 << (64 - by)) - 1)


def _to_signed(x: int) -> int:
    return x - 2**64
