"""What is seen of rigid bodies, whoever modelled them: shapes on bodies, plain enough to be kept in a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A primitive or a mesh in the frame of its body."""

    kind: str
    """box, sphere, ellipsoid, capsule, cylinder or mesh."""
    size: tuple[float, ...]
    """m. Box and ellipsoid: half-extents. Sphere: radius. Capsule and cylinder, along z: radius, half-length."""
    position: tuple[float, ...] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    """w, x, y, z."""
    color: tuple[float, ...] = (0.7, 0.7, 0.7, 1.0)
    """RGBA."""
    paint: str = ""
    """The object whose pattern it wears."""
    vertices: Array | None = None
    """Of a mesh, (k, 3), m."""
    triangles: NDArray[np.int64] | None = None
    """(f, 3)."""

    def to_json(self) -> dict[str, Any]:
        found: dict[str, Any] = {"kind": self.kind, "size": [round(x, 6) for x in self.size]}
        found |= {"position": _rounded(self.position), "quaternion": _rounded(self.quaternion)}
        found |= {"color": [round(x, 3) for x in self.color], "paint": self.paint}
        if self.vertices is not None and self.triangles is not None:
            found |= {"vertices": np.round(self.vertices, 5).tolist(), "triangles": self.triangles.tolist()}
        return found

    @staticmethod
    def from_json(content: Mapping[str, Any]) -> Shape:
        mesh = "vertices" in content
        return Shape(
            content["kind"],
            tuple(content["size"]),
            tuple(content["position"]),
            tuple(content["quaternion"]),
            tuple(content["color"]),
            content["paint"],
            np.array(content["vertices"], dtype=np.float64) if mesh else None,
            np.array(content["triangles"], dtype=np.int64) if mesh else None,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A link: its place on its parent, the joint that moves it there, and what is seen of it."""

    name: str
    parent: int
    """In the list of bodies, parents first; -1 for the palm, which stands where the hand does."""
    position: tuple[float, ...]
    quaternion: tuple[float, ...]
    """On the parent at joint position zero, m; w, x, y, z."""
    joint: int = -1
    """In the hand's order; -1: fixed."""
    axis: tuple[float, ...] = (0.0, 0.0, 1.0)
    anchor: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Of the joint, in the body's own frame; a hinge."""
    zero: float = 0.0
    """Joint position at which the body is where it is said to be, rad."""
    shapes: tuple[Shape, ...] = ()

    def to_json(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "parent": self.parent,
            "position": _rounded(self.position),
            "quaternion": list(self.quaternion),
            "joint": self.joint,
            "axis": list(self.axis),
            "anchor": _rounded(self.anchor),
            "zero": self.zero,
            "shapes": [shape.to_json() for shape in self.shapes],
        }

    @staticmethod
    def from_json(content: Mapping[str, Any]) -> Body:
        rows: dict[str, Any] = {key: tuple(content[key]) for key in ("position", "quaternion", "axis", "anchor")}
        shapes = tuple(Shape.from_json(shape) for shape in content["shapes"])
        one: dict[str, Any] = {key: content[key] for key in ("name", "parent", "joint", "zero")}
        return Body(shapes=shapes, **one, **rows)


def _rounded(values: tuple[float, ...]) -> list[float]:
    return [round(float(value), 7) for value in values]
