"""Turns that leave an object as it stands, so that the same grasp is not counted twice."""

from __future__ import annotations

import numpy as np

from allegro_twin.sim.objects.catalogue import Placement
from allegro_twin.types import Array

ROUND = 36
"""Turns that stand for any turn of something round: every 10°, half of what makes grasps different."""


def symmetry(placed: Placement) -> Array:
    """Rotations about the vertical through the object, (k, 3, 3), which leave it where it stands as it is: those of a
    cylinder or a sphere, of a box, and no other than none of a mesh."""
    thing = placed.thing
    _w, x, y, _z = placed.quaternion
    upright = abs(x) < 1e-6 and abs(y) < 1e-6
    match thing.shape:
        case "sphere":
            count = ROUND
        case "cylinder":
            count = ROUND if upright else 2
        case "ellipsoid":
            count = 2
        case "box":
            half = thing.half_extents()
            square = np.isclose(*sorted(half)[:2]) if not upright else np.isclose(half[0], half[1])
            count = 4 if square and (upright or np.allclose(half, half[0])) else 2
        case _:
            count = 1
    angles = 2.0 * np.pi * np.arange(count) / count
    c, s, zero, one = np.cos(angles), np.sin(angles), np.zeros(count), np.ones(count)
    turns: Array = np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
    return turns
