"""Appearance of a compiled scene as plain shapes, so that a recording shows it without its files or MuJoCo."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.hands.description.appearance import VisualBody, VisualShape, object_appearance
from allegro_twin.sim.hand_import.adapt import compile_model
from allegro_twin.sim.model.scene import hand_spec
from allegro_twin.spec import HandSpec
from allegro_twin.spec.arm import ArmSpec
from allegro_twin.types import Array

_KINDS = {
    int(mujoco.mjtGeom.mjGEOM_BOX): ("box", 3),
    int(mujoco.mjtGeom.mjGEOM_SPHERE): ("sphere", 1),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): ("ellipsoid", 3),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): ("capsule", 2),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): ("cylinder", 2),
    int(mujoco.mjtGeom.mjGEOM_MESH): ("mesh", 0),
}
_GROUPS = 3  # Of geoms: MuJoCo shows the first three and hides the others.
_TRIANGLES = 600  # A mesh, at most: a page in a browser draws dozens of them without a GPU.


def scene_appearance(model: mujoco.MjModel, spec: HandSpec, object_names: tuple[str, ...]) -> dict[str, Any]:
    """For a recording: the shapes of the objects and of what stands still, and of the hand if it is not ours."""
    start, palm = mujoco.MjData(model), model.body(spec.root).id
    mujoco.mj_kinematics(model, start)
    found: dict[str, Any] = {
        "palm": [round(float(x), 6) for x in (*start.xpos[palm], *start.xquat[palm])],
        "objects": {name: [shape.to_json() for shape in _shapes(model, model.body(name).id)] for name in object_names},
        "fixed": [shape.to_json() for shape in _shapes(model, 0)],
    }
    if spec.foreign is not None or isinstance(spec, ArmSpec):
        found["hand"] = [body.to_json() for body in hand_bodies(spec)]
    return found


def hand_bodies(spec: HandSpec) -> tuple[VisualBody, ...]:
    """The links of the hand's MJCF, whoever made it, from the palm on. Raises ConfigError."""
    model = compile_model(hand_spec(spec))
    root = model.body(spec.root).id
    mine = [k for k in range(model.nbody) if k == root or _stands_on(model, k, root)]
    bodies = []
    for k in mine:
        joint = next((j for j in range(model.njnt) if model.jnt_bodyid[j] == k), -1)
        name = model.joint(joint).name if joint >= 0 else ""
        bodies.append(
            VisualBody(
                name="palm" if k == root else model.body(k).name,
                parent=-1 if k == root else mine.index(model.body_parentid[k]),
                position=tuple(model.body_pos[k]) if k != root else (0.0, 0.0, 0.0),
                quaternion=tuple(model.body_quat[k]) if k != root else (1.0, 0.0, 0.0, 0.0),
                joint=spec.all_joints.index(name) if name in spec.all_joints else -1,
                axis=tuple(model.jnt_axis[joint]) if joint >= 0 else (0.0, 0.0, 1.0),
                anchor=tuple(model.jnt_pos[joint]) if joint >= 0 else (0.0, 0.0, 0.0),
                zero=float(model.qpos0[model.jnt_qposadr[joint]]) if joint >= 0 else 0.0,
                shapes=_shapes(model, k),
            )
        )
    return tuple(bodies)


def shapes_on(model: mujoco.MjModel, body: str) -> tuple[VisualShape, ...]:
    """What is seen of one body of a scene, in its frame."""
    return _shapes(model, model.body(body).id)


def _stands_on(model: mujoco.MjModel, body: int, root: int) -> bool:
    while body:
        body = int(model.body_parentid[body])
        if body == root:
            return True
    return False


def _shapes(model: mujoco.MjModel, body: int) -> tuple[VisualShape, ...]:
    first = model.body_geomadr[body]
    geoms = range(first, first + model.body_geomnum[body]) if first >= 0 else ()
    return tuple(shape for geom in geoms if (shape := _shape(model, geom)) is not None)


def _shape(model: mujoco.MjModel, geom: int) -> VisualShape | None:
    """One geom; None for what is not seen, and for planes and fields, which have no end."""
    color = model.geom_rgba[geom]
    material = model.geom_matid[geom]
    name = model.geom(geom).name
    textured = material >= 0 and (model.mat_texid[material] >= 0).any()
    if material >= 0 and not textured:
        color = model.mat_rgba[material]
    kind, sizes = _KINDS.get(int(model.geom_type[geom]), ("", 0))
    if not kind or color[3] <= 0.0 or model.geom_group[geom] >= _GROUPS:
        return None
    vertices = triangles = None
    if kind == "mesh":
        mesh = model.geom_dataid[geom]
        v, nv = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        f, nf = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        corners = model.mesh_vert[v : v + nv].astype(np.float64)
        vertices, triangles = simplified(corners, model.mesh_face[f : f + nf].astype(np.int64))
    return VisualShape(
        kind,
        tuple(float(x) for x in model.geom_size[geom][:sizes]),
        tuple(float(x) for x in model.geom_pos[geom]),
        tuple(float(x) for x in model.geom_quat[geom]),
        tuple(float(x) for x in color),
        paint=name if textured and object_appearance(name).pattern != "plain" else "",
        vertices=vertices,
        triangles=triangles,
    )


def simplified(
    vertices: Array, triangles: NDArray[np.int64], most: int = _TRIANGLES
) -> tuple[Array, NDArray[np.int64]]:
    """A mesh of no more than so many triangles: vertices that share a cell of a grid become one, in their middle.

    Rossignac and Borrel, "Multi-resolution 3D approximations for rendering complex scenes", 1993.
    """
    cells, extent = 64, float(np.ptp(vertices, axis=0).max())
    found, kept = vertices, triangles
    while len(kept) > most and cells > 2:
        keys = np.round((vertices - vertices.min(axis=0)) / extent * cells).astype(np.int64)
        _, index = np.unique(keys, axis=0, return_inverse=True)
        index = index.reshape(-1)
        count = np.bincount(index).astype(np.float64)
        found = np.stack([np.bincount(index, weights=column) / count for column in vertices.T], axis=1)
        kept = index[triangles]
        alive = (kept[:, 0] != kept[:, 1]) & (kept[:, 1] != kept[:, 2]) & (kept[:, 0] != kept[:, 2])
        kept = np.unique(kept[alive], axis=0)
        cells = cells * 3 // 4
    return found, kept
