"""Friction that falls while a hand warms up: F and B times 1 + c exp(−t / τ), t since the motors were switched on.

F: dry friction, B: damping, c: `cold_friction`, τ: `warm_up`; a joint whose τ is 0 does not change.
"""

from __future__ import annotations

import numpy as np

from allegro_twin.types import Array, Vector


def warmth(cold_friction: Vector, warm_up: Vector, time: Array | float) -> Array:
    """The factor on friction and damping of all joints at a time, (…, 1) s → (…, n)."""
    falls = np.exp(-time / np.where(warm_up > 0.0, warm_up, np.inf))
    return np.asarray(1.0 + np.where(warm_up > 0.0, cold_friction, 0.0) * falls)
