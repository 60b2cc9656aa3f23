"""Between the palm's orientation, which the IMU reports, and gravity in the palm frame, which controllers need."""

from __future__ import annotations

import math

import numpy as np

from allegro_twin.drivers.can.codec.messages import Four
from allegro_twin.types import Vector, frozen

STANDARD_GRAVITY = 9.81  # m/s², as in every scene.


def gravity_of(orientation: Four) -> Vector:
    """Gravity in the palm frame, (3,), m/s²: R(q)ᵀ (0, 0, −g), with q = w, x, y, z from palm to world. NaN for a
    quaternion of no length."""
    length = math.hypot(*orientation)
    if length < 0.5:  # A unit quaternion in 16-bit words is within 1e-4 of one; this is none.
        return frozen(np.full(3, math.nan))
    w, x, y, z = (value / length for value in orientation)
    up = (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))  # World z in the palm frame.
    return frozen([-STANDARD_GRAVITY * value for value in up])


def orientation_of(gravity: Vector) -> Four:
    """A unit quaternion whose gravity this is, (3,) in the palm frame; which of them, about the vertical, is free."""
    x, y, z = (-gravity).tolist()
    length = math.sqrt(x * x + y * y + z * z)
    w = 1.0 + z / length
    if w < 1e-9:
        return (0.0, 1.0, 0.0, 0.0)
    # The shortest turn that brings `up` in the palm frame to z in the world.
    a, b = y / length, -x / length
    size = math.sqrt(w * w + a * a + b * b)
    return (w / size, a / size, b / size, 0.0)
