"""Choice of the observed object that was requested, by its extents, since a camera knows no names."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from allegro_twin.cell.perception.errors import PerceptionRefusal
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.sim.objects.catalogue import GraspObject, outer_points
from allegro_twin.types import Array

_FITS = 0.4
"""Largest logarithm of a ratio of extents between the requested and an observed object. A mug's handle, which no solid
has, makes 0.35."""
_TURNS = np.radians(np.arange(0.0, 90.0, 2.0))


def wanted_first(
    detections: Sequence[Detection | PerceptionRefusal], wanted: GraspObject
) -> Sequence[Detection | PerceptionRefusal]:
    """What was seen, with what is most like the object that was wanted for in front; as it is where nothing is."""
    poses = resting_extents(wanted)
    costs = [unlikeness(each.solid.size, poses) if isinstance(each, Detection) else np.inf for each in detections]
    best = int(np.argmin(costs))
    return [detections[best], *detections[:best], *detections[best + 1 :]] if costs[best] < _FITS else detections


def unlikeness(size: Sequence[float], poses: Array) -> float:
    """The largest logarithm of a ratio of sorted extents, in whichever pose (k, 3), m, that is least."""
    ratios = np.abs(np.log(np.sort(np.asarray(size)) / poses)).max(axis=1)
    return float(ratios.min(initial=np.inf))


def resting_extents(grasp_object: GraspObject) -> Array:
    """The sorted edges of the boxes around an object, (k, 3), m: upright along each of its own axes, and across it as
    small as any turn makes it. Raises ConfigError for a file that is not readable."""
    if grasp_object.shape not in ("mesh", "mjcf"):
        return np.sort(2.0 * grasp_object.half_extents())[None]
    points = grasp_object.mesh().vertices if grasp_object.shape == "mesh" else outer_points(grasp_object)
    found = []
    for up in range(3):
        across = np.delete(points, up, axis=1)
        directions = np.stack([np.cos(_TURNS), np.sin(_TURNS)])
        edges = np.stack(
            [np.ptp(across @ directions, axis=0), np.ptp(across @ [-directions[1], directions[0]], axis=0)], axis=1
        )
        found.append([*edges[np.argmin(edges.prod(axis=1))], np.ptp(points[:, up])])
    return np.sort(found, axis=1)
