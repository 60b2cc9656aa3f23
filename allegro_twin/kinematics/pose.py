"""Poses: position and orientation of a frame in another, with the orientation as matrix, quaternion or Euler angles."""

from __future__ import annotations

from typing import NamedTuple

from allegro_twin.kinematics.orientation import euler_from_matrix, quaternion_from_matrix
from allegro_twin.types import Array


class Pose(NamedTuple):
    """A frame in the palm frame, or a batch of them."""

    position: Array
    """Shape (..., 3), m."""
    rotation: Array
    """Matrix, shape (..., 3, 3): its columns are the frame's axes in the palm."""

    @property
    def quaternion(self) -> Array:
        """Unit quaternion (w, x, y, z) with w ≥ 0, shape (..., 4)."""
        return quaternion_from_matrix(self.rotation)

    @property
    def euler(self) -> Array:
        """Roll, pitch, yaw as in `kinematics.orientation`, shape (..., 3), rad."""
        return euler_from_matrix(self.rotation)


def compose(frame: Pose, pose: Pose) -> Pose:
    """A pose that is given in a frame, in the frame's own reference."""
    return Pose(frame.position + frame.rotation @ pose.position, frame.rotation @ pose.rotation)


def relative_to(frame: Pose, pose: Pose) -> Pose:
    """A pose in a frame, both given in one reference: the inverse of `compose`."""
    return Pose(frame.rotation.T @ (pose.position - frame.position), frame.rotation.T @ pose.rotation)
