"""Grasp target: the pose of the hand to grasp an object, the report's `target_hand` frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from allegro_twin.cell.perception.errors import PerceptionRefusal, position_text
from allegro_twin.cell.perception.fits.model import Solid, half_width
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.perception.settings import TargetSettings
from allegro_twin.kinematics.orientation import quaternion_from_matrix
from allegro_twin.types import Array, Vector

_UP = np.array([0.0, 0.0, 1.0])
_EQUAL = 0.93
"""Edges whose ratio is nearer to 1 than this are of one length: which of them is the main one is free."""


@dataclass(frozen=True, slots=True, eq=False)
class GraspTarget:
    """A frame for the hand in the world: y along the thing's main axis, z towards its middle, x across."""

    position: Vector
    """(3,), m."""
    rotation: Array
    """Its axes, columns of (3, 3)."""
    width: float
    """Extent of the object along x, on which the hand has to close, m."""
    depth: float
    """Extent of the object along z, m."""

    @property
    def quaternion(self) -> Vector:
        """w, x, y, z."""
        return quaternion_from_matrix(self.rotation)


def grasp_target(
    found: Detection, settings: TargetSettings, before: GraspTarget | None = None
) -> GraspTarget | PerceptionRefusal:
    """The frame as the report makes it.

    y is the main axis; z is the world's vertical, projected onto the plane across y, normalised and reversed, or the
    `fallback` where y is upright; x = y × z, z = x × y; then back along z by half the thing's depth and the offset.
    Where symmetry leaves y open it is as near as can be to that of `before`, without one to the fallback: a ball does
    not turn, and no frame flips.
    """
    y = main_axis(found.solid, np.array(settings.fallback) if before is None else before.rotation[:, 1])
    reference = np.array(settings.fallback) if abs(y @ _UP) > settings.upright else _UP
    z = -(reference - (reference @ y) * y)
    x = np.cross(y, z / np.linalg.norm(z))
    x /= np.linalg.norm(x)
    z = np.cross(x, y)
    half = half_width(found.solid, z)
    at = found.solid.position - (half + settings.offset) * z
    above = float(found.table.height(at))
    if above < settings.clearance:
        said = f"the target {position_text(at)} for the {found.solid.shape} is {above:.3f} m above the table"
        way = f"{settings.clearance} m are needed: turn the thing so that it can be grasped from above"
        return PerceptionRefusal("in_table", f"{said}, and {way}, or lower `target.clearance`")
    return GraspTarget(at, np.stack([x, y, z], axis=1), 2.0 * half_width(found.solid, x), 2.0 * half)


def main_axis(solid: Solid, near: Vector) -> Vector:
    """The direction in which it is longest, (3,), on the side of `near` (3,).

    Where several are of one length it is a level one, the nearest: any of a ball, one across the axis of a flat can,
    one of a cube's edges.
    """
    axes, size = solid.axes.T, solid.size
    if solid.shape == "sphere":
        return _across(_UP, near)
    if solid.shape in ("box", "compound"):
        longest = [axis for axis, edge in zip(axes, size, strict=True) if edge > _EQUAL * size[0]]
        level = [axis for axis in longest if abs(axis @ _UP) < 0.5] or longest
        axis = max(level, key=lambda each: abs(float(each @ near)))
    elif abs(axes[0] @ _UP) > 0.5:  # Upright: of equal lengths the level one.
        axis = _across(axes[0], near) if size[0] < size[1] / _EQUAL else axes[0]
    else:  # Lying: a flat one is long across its axis, level.
        axis = _across(axes[0], np.cross(_UP, axes[0])) if size[0] < size[1] * _EQUAL else axes[0]
    return np.asarray(axis if axis @ near >= 0.0 else -axis)


def _across(axis: Vector, near: Vector) -> Vector:
    """The unit vector across an axis that is nearest to `near`, or any where that goes along it."""
    left = near - (near @ axis) * axis
    if np.linalg.norm(left) < 1e-6:
        left = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    return np.asarray(left / np.linalg.norm(left))
