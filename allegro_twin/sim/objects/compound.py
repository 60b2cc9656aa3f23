"""Several primitives as one rigid body, in an MJCF of its own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco

from allegro_twin.sim.objects.catalogue import GraspObject, PlacedObject

_GEOMS = {
    "sphere": (mujoco.mjtGeom.mjGEOM_SPHERE, (0,)),
    "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, (0, 2)),
    "box": (mujoco.mjtGeom.mjGEOM_BOX, (0, 1, 2)),
    "ellipsoid": (mujoco.mjtGeom.mjGEOM_ELLIPSOID, (0, 1, 2)),
}
"""The geom of a shape, and which of its half extents are its sizes."""


def write_compound(parts: Sequence[PlacedObject], path: Path) -> None:
    """A body of primitives, each where it is from the body's middle and with its own mass, kg, as an MJCF. What two of
    them share has the mass of both."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="compound")
    for part in parts:
        kind, size = _geom(part.grasp_object)
        body.add_geom(
            type=kind, size=size, pos=part.position, quat=part.quaternion, mass=part.grasp_object.mass,
        )  # fmt: skip
    spec.compile()  # Only what was compiled is written.
    path.write_text(spec.to_xml())


def _geom(grasp_object: GraspObject) -> tuple[mujoco.mjtGeom, list[float]]:
    kind, which = _GEOMS[grasp_object.shape]
    half = grasp_object.half_extents()
    return kind, [*half[list(which)].tolist(), 0.0, 0.0][:3]
