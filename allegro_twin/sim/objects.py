"""Things to grasp: the YCB table, primitives, and the user's own meshes and MJCF."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeAlias

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.kinematics.orientation import turned_by
from allegro_twin.types import Array, Vector

Shape: TypeAlias = Literal["sphere", "cylinder", "box", "ellipsoid", "mesh", "mjcf"]
N_SIZES: dict[str, int] = {"sphere": 1, "cylinder": 2, "box": 3, "ellipsoid": 2}
_UP = {"x": (0.5, -0.5, -0.5, -0.5), "y": (0.5, 0.5, 0.5, 0.5), "z": (1.0, 0.0, 0.0, 0.0)}


@dataclass(frozen=True, slots=True)
class Thing:
    """One rigid object. Its frame sits at the middle of its shape."""

    name: str
    shape: Shape
    size: tuple[float, ...]
    """m. Sphere: diameter. Cylinder: diameter, height. Box: edges. Ellipsoid: short and long (along x) diameter."""
    mass: float
    """kg. NaN for an MJCF, which brings its own."""
    file: Path | None = None
    """For `mesh` and `mjcf`."""
    scale: float = 1.0
    """Of a mesh: file units to m."""

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
        raise ConfigError(f"object {self.name}: a {self.shape} has no size here; give its height with `at`")


@dataclass(frozen=True, slots=True)
class Placement:
    """A thing in the scene."""

    thing: Thing
    position: tuple[float, float, float]
    """Of the middle of its shape, world, m."""
    quaternion: tuple[float, float, float, float]
    """w, x, y, z."""


def orientation(up: str, yaw: float) -> Vector:
    """The quaternion that points the object's own axis `up` at the sky and then turns it by `yaw` (rad) about it."""
    return turned_by(_UP[up], (0.0, 0.0, yaw))


@cache
def catalogue() -> dict[str, Thing]:
    """The objects that ship with the package, by name (conf/objects/*.yaml; sizes there in mm, masses in g)."""
    things = {}
    for path in sorted((data_root() / "conf" / "objects").glob("*.yaml")):
        for name, row in read_yaml(path).items():
            things[name] = _thing(path, name, row)
    return things


def named(name: str) -> Thing:
    """A thing from the catalogue. Raises ConfigError with the nearest names."""
    if name not in catalogue():
        raise ConfigError(unknown("object", name, catalogue()))
    return catalogue()[name]


def _thing(path: Path, name: str, row: dict[str, Any]) -> Thing:
    shape, size, mass = row["shape"], tuple(value / 1000.0 for value in row["size"]), row["mass"] / 1000.0
    if len(size) != N_SIZES[shape]:
        raise ConfigError(f"{path}: {name}: a {shape} has {N_SIZES[shape]} sizes, not {len(size)}")
    return Thing(name, shape, size, mass)


def add(spec: mujoco.MjSpec, placement: Placement, friction: tuple[float, float, float]) -> None:
    """Put a thing into the scene as a free body named after it. `friction`: sliding, torsional (m), rolling (m)."""
    thing = placement.thing
    if thing.shape == "mjcf":
        _attach(spec, placement)
        return
    body = spec.worldbody.add_body(name=thing.name, pos=placement.position, quat=placement.quaternion)
    body.add_freejoint(name=thing.name)
    look = {"friction": friction, "condim": 6, "mass": thing.mass, "rgba": _color(thing.name), "name": thing.name}
    match thing.shape, thing.size:
        case "sphere", (d,):
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[d / 2, 0, 0], **look)
        case "cylinder", (d, h):
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[d / 2, h / 2, 0], **look)
        case "ellipsoid", _:
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size=thing.half_extents(), **look)
        case "box", _:
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=thing.half_extents(), **look)
        case _:
            spec.add_mesh(name=thing.name, file=str(Path(str(thing.file)).resolve()), scale=[thing.scale] * 3)
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=thing.name, **look)


def _attach(spec: mujoco.MjSpec, placement: Placement) -> None:
    thing = placement.thing
    try:
        child = mujoco.MjSpec.from_file(str(thing.file))
    except (ValueError, OSError) as error:
        raise ConfigError(f"object {thing.name}: {thing.file}: not a readable MJCF: {_first_line(error)}") from error
    roots = child.worldbody.bodies
    if len(roots) != 1:
        raise ConfigError(f"object {thing.name}: {thing.file}: must hold one body in its world, not {len(roots)}")
    frame = spec.worldbody.add_frame(pos=placement.position, quat=placement.quaternion)
    body = frame.attach_body(roots[0], f"{thing.name}/", "")
    for joint in list(body.joints):
        spec.delete(joint)
    body.name = thing.name
    body.pos, body.quat = [0, 0, 0], [1, 0, 0, 0]
    body.add_freejoint(name=thing.name)


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__


def _color(name: str) -> list[float]:
    """A calm colour that stays with the name."""
    hue = (sum(ord(c) * (i + 7) for i, c in enumerate(name)) * 0.6180339887) % 1.0
    r, g, b = (0.55 + 0.35 * math.cos(2 * math.pi * (hue + shift)) for shift in (0.0, 1 / 3, 2 / 3))
    return [r, g, b, 1.0]
