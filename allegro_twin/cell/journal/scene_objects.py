"""Solids of a planning scene from perception: the table, the target, and a box around each other object."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.kinematics.pose import Pose
from allegro_twin.recording.messages.planning_scene import SceneObject
from allegro_twin.types import Array, Vector

TABLE, TARGET = "table", "target"
"""Their names in the scene; other objects are object_0, object_1, ..."""
_WIDE, _THICK = 1.0, 0.04  # m, of the box for the table, whose edges nobody sees.
_ROUND = {"sphere": "sphere", "cylinder": "cylinder"}


def scene_objects(found: Mapping[str, Any], clutter: Array) -> list[SceneObject]:
    """Solids in the world. `found`: the row of the perception track; `clutter`: middle and extents of the upright box
    around each other object, (k, 6), m. A solid that is neither a ball nor a cylinder is the box around it."""
    shape, size = str(found["shape"]), tuple(float(edge) for edge in found["size"])
    kind: Any = _ROUND.get(shape, "box")
    target = SceneObject(TARGET, kind, _pose(found["pose"]), size)  # type: ignore[arg-type]  # Three.
    boxes = [
        SceneObject(f"object_{k}", "box", Pose(box[:3], np.eye(3)), (float(box[3]), float(box[4]), float(box[5])))
        for k, box in enumerate(clutter)
    ]
    return [_table(np.asarray(found["table"], np.float64)), target, *boxes]


def _table(plane: Vector) -> SceneObject:
    """A box whose top is the plane n · p = d, given as (n, d)."""
    normal, offset = plane[:3], float(plane[3])
    x = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(normal, x), normal], axis=1)
    return SceneObject(TABLE, "box", Pose((offset - _THICK / 2.0) * normal, axes), (_WIDE, _WIDE, _THICK))


def _pose(numbers: Vector) -> Pose:
    return Pose(np.asarray(numbers[:3], np.float64), matrix_from_quaternion(numbers[3:]))
