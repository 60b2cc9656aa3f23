"""Small vector algebra on rows; a row's result does not depend on how many there are (BLAS's products do)."""

from __future__ import annotations

import numpy as np

from allegro_twin.types import Array


def length(v: Array) -> Array:
    """Of vectors (..., k), shape (...)."""
    size: Array = np.sqrt(np.add.reduce(v * v, axis=-1))
    return size


def effort_of(action: Array) -> Array:
    """What moving costs in most rewards, actions (..., n) in [-1, 1], shape (...)."""
    cost: Array = np.add.reduce(action * action, axis=-1) * (-0.02 / action.shape[-1])
    return cost
