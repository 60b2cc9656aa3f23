"""Things to grasp: the YCB table, primitives, and the user's own meshes and MJCF."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, TypeAlias

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.kinematics.orientation import rotate_quaternion
from allegro_twin.sim.objects import textures
from allegro_twin.sim.objects.convex_decomposition import convex_parts
from allegro_twin.sim.objects.meshes import Mesh, load_hull, load_mesh
from allegro_twin.types import Array, Vector

Collision: TypeAlias = Literal["pieces", "hull"]
ObjectKind: TypeAlias = Literal["sphere", "cylinder", "box", "ellipsoid", "mesh", "mjcf"]
SIZES_OF_KIND: dict[str, int] = {"sphere": 1, "cylinder": 2, "box": 3, "ellipsoid": 2}
_ANY, _STANDING, _CUT = 1, 2, 4
"""Bits of who touches whom: everything, a cut solid's hull with the table, and its pieces with those of another."""
_PRIMITIVES: dict[ObjectKind, mujoco.mjtGeom] = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
}
_POINT = 1e-5
"""m: half the size of a geom that stands in for a shape that a thing has not."""
_UP = {"x": (0.5, -0.5, -0.5, -0.5), "y": (0.5, 0.5, 0.5, 0.5), "z": (1.0, 0.0, 0.0, 0.0)}


@dataclass(frozen=True, slots=True)
class GraspObject:
    """One rigid object. Its frame sits at the middle of its shape."""

    name: str
    shape: ObjectKind
    size: tuple[float, ...]
    """m. Sphere: diameter. Cylinder: diameter, height. Box: edges. Ellipsoid: short and long (along x) diameter."""
    mass: float
    """kg. NaN for an MJCF, which brings its own."""
    file: Path | None = None
    """For `mesh` and `mjcf`."""
    scale: float | None = None
    """Unit of a mesh's file, m; None: as the file or its size says."""
    collision: Collision = "pieces"
    """How a mesh collides: as what it is, in convex pieces, or as its hull."""

    stretch: float = 1.0
    """Factor by which a mesh is larger than its file's. It is cut into pieces as it was before."""

    def half_extents(self) -> Array:
        """Half-sizes of the bounding box in the object's own axes, shape (3,), m. Not for files."""
        match self.shape, self.size:
            case "sphere", (d,):
                return np.full(3, d / 2)
            case "cylinder", (d, h):
                return np.array([d, d, h]) / 2
            case "ellipsoid", (short, long):
                return np.array([long, short, short]) / 2
            case "box", edges:
                return np.array(edges) / 2
            case "mesh", _:
                return self.mesh().extents / 2
        raise ConfigError(f"object {self.name}: a {self.shape} has no size here; give its height with `at`")

    def mesh(self) -> Mesh:
        """Surface of a mesh, or its hull's. Raises ConfigError."""
        return self._mesh().times(self.stretch)

    def convex_parts(self) -> list[Mesh]:
        """Convex pieces of a mesh, which are its contact shapes. Raises ConfigError."""
        return [piece.times(self.stretch) for piece in convex_parts(self._mesh(), str(self.file))]

    def _mesh(self) -> Mesh:
        assert self.file is not None
        return load_mesh(self.file, self.scale) if self.collision == "pieces" else load_hull(self.file, self.scale)


@dataclass(frozen=True, slots=True)
class PlacedObject:
    """A thing in the scene."""

    grasp_object: GraspObject
    position: tuple[float, float, float]
    """Middle of its shape in the world, m."""
    quaternion: tuple[float, float, float, float]
    """w, x, y, z."""


def standing_orientation(up: str, yaw: float) -> Vector:
    """The quaternion that points the object's own axis `up` at the sky and then turns it by `yaw` (rad) about it."""
    return rotate_quaternion(_UP[up], (0.0, 0.0, yaw))


def object_catalogue() -> dict[str, GraspObject]:
    """The objects that ship with the package, by name (conf/objects/*.yaml; sizes there in mm, masses in g)."""
    files = sorted((data_root() / "conf" / "objects").glob("*.yaml"))
    return _read_all(tuple((path, path.stat().st_mtime_ns) for path in files))


@lru_cache(maxsize=2)
def _read_all(files: tuple[tuple[Path, int], ...]) -> dict[str, GraspObject]:
    objects = {}
    for path, _ in files:  # What was edited since is read again.
        for name, row in read_yaml(path).items():
            objects[name] = _grasp_object(path, name, row)
    return objects


def load_object(name: str) -> GraspObject:
    """A thing from the catalogue. Raises ConfigError with the nearest names."""
    if name not in object_catalogue():
        raise ConfigError(unknown("object", name, object_catalogue()))
    return object_catalogue()[name]


def _grasp_object(path: Path, name: str, row: dict[str, Any]) -> GraspObject:
    shape, size, mass = row["shape"], tuple(value / 1000.0 for value in row["size"]), row["mass"] / 1000.0
    if len(size) != SIZES_OF_KIND[shape]:
        raise ConfigError(f"{path}: {name}: a {shape} has {SIZES_OF_KIND[shape]} sizes, not {len(size)}")
    return GraspObject(name, shape, size, mass)


def add_object(
    spec: mujoco.MjSpec, placement: PlacedObject, friction: tuple[float, float, float], *, every_shape: bool = False
) -> None:
    """Put a thing into the scene as a free body named after it. `friction`: sliding, torsional (m), rolling (m).

    `every_shape`: with a geom for each primitive shape, in one order, so that scenes of different things have the same
    layout. Those that the thing does not have are points in its middle, which nothing reaches.
    """
    grasp_object = placement.grasp_object
    if any(find(grasp_object.name) is not None for find in (spec.body, spec.joint, spec.geom, spec.mesh)):
        other = "give the object another one by its `name`"
        if grasp_object.shape == "mesh":
            other += ", or rename its file where it is named after that, as with --object"
        raise ConfigError(
            f"object {grasp_object.name}: another part of the scene has this name, of the hand, of the arm or of what "
            f"stands there; {other}"
        )
    if grasp_object.shape == "mjcf":
        _attach(spec, placement, friction)
        return
    body = spec.worldbody.add_body(name=grasp_object.name, pos=placement.position, quat=placement.quaternion)
    body.add_freejoint(name=grasp_object.name)
    look = {"friction": friction, "condim": 6, "mass": grasp_object.mass, "name": grasp_object.name}
    look |= textures.geom_look(spec, grasp_object.name)
    if grasp_object.shape == "mesh":
        _add_mesh(spec, body, grasp_object, look)
        return
    for shape, kind in _PRIMITIVES.items():
        if shape == grasp_object.shape:
            body.add_geom(type=kind, size=_half_sizes(grasp_object), **look)
        elif every_shape:
            body.add_geom(type=kind, size=[_POINT] * 3, **look | {"name": "", "mass": 0.0})
    if grasp_object.shape == "cylinder":
        textures.add_handle(body, grasp_object.name, grasp_object.size[0] / 2)


def _half_sizes(grasp_object: GraspObject) -> Array:
    """As a geom of its shape has them, (3,), m."""
    half = grasp_object.half_extents()
    used = {"sphere": half[:1], "cylinder": half[1:]}.get(grasp_object.shape, half)
    return np.concatenate([used, np.zeros(3 - len(used))])


def _add_mesh(spec: mujoco.MjSpec, body: mujoco.MjsBody, grasp_object: GraspObject, look: dict[str, Any]) -> None:
    """What is seen, and has the mass and the inertia of the solid; and the convex pieces that touch."""
    mesh = grasp_object.mesh()
    kind = mujoco.mjtGeom.mjGEOM_MESH
    made = spec.add_mesh(name=grasp_object.name, uservert=mesh.vertices.ravel(), userface=mesh.faces.ravel())
    made.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT
    body.add_geom(type=kind, meshname=grasp_object.name, contype=0, conaffinity=0, **look)
    touch = {"type": kind, "mass": 0.0, "group": 3} | {key: look[key] for key in ("friction", "condim")}
    parts = grasp_object.convex_parts()
    table = spec.geom("table") if len(parts) > 1 else None
    if table is not None:
        touch |= _stood(body, table, grasp_object.name, touch)
    for number, piece in enumerate(parts):
        name = f"{grasp_object.name}/{number}"
        spec.add_mesh(name=name, uservert=piece.vertices.ravel())
        body.add_geom(name=name, meshname=name, **touch)


def _stood(body: mujoco.MjsBody, table: mujoco.MjsGeom, name: str, touch: dict[str, Any]) -> dict[str, Any]:
    """Let a body stand on the table by its hull alone, which touches a plane exactly where the solid does: dozens of
    pieces would make a hundred contacts there. Returns what the pieces say of whom they touch."""
    table.contype, table.conaffinity = _STANDING, _ANY | _STANDING
    body.add_geom(name=f"{name}/standing", meshname=name, contype=_STANDING, conaffinity=0, **touch)
    return {"contype": _CUT, "conaffinity": _ANY | _CUT}


def _attach(spec: mujoco.MjSpec, placement: PlacedObject, friction: tuple[float, float, float]) -> None:
    """The body of an MJCF; its own friction does not count, since of two geoms that touch the rougher one's does."""
    grasp_object = placement.grasp_object
    try:
        child = mujoco.MjSpec.from_file(str(grasp_object.file))
    except (ValueError, OSError) as error:
        raise ConfigError(
            f"object {grasp_object.name}: {grasp_object.file}: not a readable MJCF: {_first_line(error)}"
        ) from error
    roots = child.worldbody.bodies
    if len(roots) != 1:
        raise ConfigError(
            f"object {grasp_object.name}: {grasp_object.file}: must hold one body in its world, not {len(roots)}"
        )
    frame = spec.worldbody.add_frame(pos=placement.position, quat=placement.quaternion)
    body = frame.attach_body(roots[0], f"{grasp_object.name}/", "")
    for joint in list(body.joints):
        spec.delete(joint)
    body.name = grasp_object.name
    body.pos, body.quat = [0, 0, 0], [1, 0, 0, 0]
    body.add_freejoint(name=grasp_object.name)
    for geom in body.find_all("geom"):
        geom.friction, geom.condim, geom.priority = friction, 6, 0


def outer_points(grasp_object: GraspObject) -> Array:
    """Corners of the boxes around the geoms of an MJCF's body, in its frame, (k, 3), m. Raises ConfigError."""
    spec = mujoco.MjSpec()
    _attach(spec, PlacedObject(grasp_object, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), (1.0, 0.0, 0.0))
    try:
        model = spec.compile()
    except ValueError as error:
        raise ConfigError(f"object {grasp_object.name}: {grasp_object.file}: {_first_line(error)}") from error
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    boxes = model.geom_aabb[:, None, :3] + corners * model.geom_aabb[:, None, 3:]
    turn = data.geom_xmat.reshape(-1, 1, 3, 3)
    points: Array = ((turn @ boxes[..., None])[..., 0] + data.geom_xpos[:, None]).reshape(-1, 3)
    return points


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
