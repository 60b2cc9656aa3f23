"""Overlays: marks drawn into a picture where something should be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from allegro_twin.types import Array

_KINDS = {"sphere": mujoco.mjtGeom.mjGEOM_SPHERE, "box": mujoco.mjtGeom.mjGEOM_BOX}


@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """A body that nothing touches."""

    kind: str
    """sphere or box."""
    size: Array
    """Half-extents, (3,), m."""
    pose: Array
    """Position and quaternion in the world, (7,), m."""
    color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    material: str | None = None
    """Material of the scene, in place of the colour."""


def add(scene: Any, model: mujoco.MjModel, marks: Sequence[Mark]) -> None:
    """Put them behind what a scene (mjvScene) has already, as far as it has room."""
    for mark in marks[: scene.maxgeom - scene.ngeom]:
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, mark.pose[3:])
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(geom, _KINDS[mark.kind], mark.size, mark.pose[:3], turn, np.array(mark.color, np.float32))
        if mark.material is not None:
            geom.matid = model.material(mark.material).id
        scene.ngeom += 1
