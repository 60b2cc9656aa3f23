"""Orientations from directions that a person can name."""

from __future__ import annotations

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.types import Array, Vector


def orientation(x: tuple[float, float, float], z: tuple[float, float, float]) -> Vector:
    """The quaternion (w, x, y, z) of a palm that looks along `x` with its fingers towards `z`, world axes."""
    return quaternion(facing(x, z))


def quaternion(rotation: Array) -> Vector:
    """w, x, y, z of a rotation matrix (3, 3)."""
    result = np.empty(4)
    mujoco.mju_mat2Quat(result, rotation.reshape(9))
    return result


def facing(x: tuple[float, float, float], z: tuple[float, float, float]) -> Array:
    """The rotation whose x axis is along `x` and whose z axis is as near to `z` as it can be, (3, 3)."""
    first = np.array(x) / np.linalg.norm(x)
    last = np.array(z) - first * (first @ z)
    if np.linalg.norm(last) < 1e-6:
        raise ConfigError(f"wrist: fingers {list(z)} must not be parallel to facing {list(x)}")
    last /= np.linalg.norm(last)
    return np.stack([first, np.cross(last, first), last], axis=1)
