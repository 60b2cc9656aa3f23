"""A camera whose place, orientation and opening are given: none of MuJoCo's own can say all three."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from allegro_twin.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """A pinhole in the world. Its axes are the field's for pictures: x right, y down, z ahead."""

    position: Array
    """(3,), m."""
    rotation: Array
    """Its axes in the world, columns of (3, 3)."""
    left: float
    right: float
    up: float
    down: float
    """Where the picture ends at a distance of 1 m ahead, m: left and up are negative."""

    def eye(self) -> mujoco.MjvCamera:
        """A camera of MuJoCo's own from there and along it: what lights go by."""
        eye, ahead = mujoco.MjvCamera(), self.rotation[:, 2]
        eye.distance, eye.lookat = 1.0, self.position + ahead
        eye.azimuth = float(np.degrees(np.arctan2(ahead[1], ahead[0])))
        eye.elevation = float(np.degrees(np.arcsin(np.clip(ahead[2], -1.0, 1.0))))
        return eye

    def onto(self, cameras: Any) -> None:
        """Into the cameras of a scene, one for each eye, whose near and far planes stay."""
        for camera in cameras:
            near = camera.frustum_near
            camera.pos, camera.forward, camera.up = self.position, self.rotation[:, 2], -self.rotation[:, 1]
            camera.frustum_center = near * (self.left + self.right) / 2.0
            camera.frustum_width = near * (self.right - self.left) / 2.0
            camera.frustum_bottom, camera.frustum_top = -near * self.down, -near * self.up
