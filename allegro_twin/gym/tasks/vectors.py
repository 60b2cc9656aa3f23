"""Small vector algebra on rows, written out so that a row's result does not depend on how many there are."""

from __future__ import annotations

import numpy as np

from allegro_twin.types import Array


def length(v: Array) -> Array:
    """Of vectors (..., 3), shape (...)."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    return np.sqrt(x * x + y * y + z * z)
