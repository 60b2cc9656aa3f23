"""What a policy's interface remembers from one decision to the next, and what it lets happen between them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.types import Array


class Memory(NamedTuple):
    """What the interface remembers between two decisions."""

    begin: Array
    """Offset from the base when the running action was taken, shape (..., n), rad."""
    end: Array
    """Offset to be reached when the next is taken, shape (..., n), rad."""
    push: Array
    """Torque of the running action, shape (..., n), N·m; only in the mode `torque`."""
    tick: NDArray[np.int64]
    """Control periods since the beginning when the running action was taken, shape (...)."""
    script: NDArray[np.int64]
    """Which motion is followed, shape (...)."""
    past: NDArray[np.float32]
    """What was seen at the decisions before, the last one first; zeros where there were none. Shape (..., k)."""


class Course(NamedTuple):
    """Set-points of every control period from one decision to the next."""

    wish: Array | None
    """Targets, rad, and their rates, rad/s: shape (decimation, 2, ..., n); None: torque alone."""
    push: Array | None
    """Torque on top, shape (..., n), N·m."""
