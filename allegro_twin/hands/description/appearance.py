"""Appearance: colours of objects, fingers and joints, and the shapes that are drawn of rigid bodies."""

from __future__ import annotations

import colorsys
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.types import Array

Color = tuple[float, float, float]
"""Red, green, blue, 0 to 1."""
TABLE: Color = (0.78, 0.70, 0.60)
STAND: Color = (0.62, 0.56, 0.50)
LIMIT: Color = (0.55, 0.55, 0.55)
# Okabe and Ito, "Color Universal Design" (2008): told apart by the colour-blind too.
_SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8c8c00")
_FACES = ("#c41e3a", "#ff5800", "#009e60", "#0051ba", "#ffd500", "#ffffff")  # +x, -x, +y, -y, +z, -z.
_BAND, _STICKER = 0.45, 0.4
"""Half the height of a band in half-extents, and half the width of a sticker in its cell."""
_PATTERNS = ("plain", "band", "lines", "halves", "faces")


@dataclass(frozen=True, slots=True)
class ObjectHandle:
    """A loop on an object's side that is drawn and never touched."""

    height: float
    """Height of the loop, m."""
    reach: float
    """How far it stands out, m."""
    thick: float
    """m."""
    at: float
    """About the object's z, from its x, rad."""


@dataclass(frozen=True, slots=True)
class ObjectAppearance:
    """Colours, pattern and handle of an object."""

    color: Color
    second: Color
    pattern: str = "plain"
    handle: ObjectHandle | None = None

    def paint(self, place: Array) -> Array:
        """Colours (k, 3) at places on the surface, (k, 3), in units of the object's half-extents."""
        x, y, z = np.moveaxis(place / np.maximum(np.abs(place).max(axis=1, keepdims=True), 1e-9), 1, 0)
        largest = np.abs(place).argmax(axis=1)
        match self.pattern:
            case "band":
                second = (np.abs(place[:, 2]) < _BAND) & (largest != 2)
            case "lines":
                unit = place / np.maximum(np.linalg.norm(place, axis=1, keepdims=True), 1e-9)
                second = np.abs(unit).min(axis=1) < 0.07
            case "halves":
                second = x + y + 0.5 * z > 0.3
            case "faces":
                return self._stickers(np.stack([x, y, z], axis=1), largest)
            case _:
                second = np.zeros(len(place), dtype=bool)
        return np.where(second[:, None], np.array(self.second), np.array(self.color))

    def box_edges(self) -> Array:
        """Where colours may change along an edge of a box, both ends included, in half-extents, (k,)."""
        match self.pattern:
            case "plain":
                return np.array([-1.0, 1.0])
            case "band":
                return np.array([-1.0, -_BAND, _BAND, 1.0])
            case "faces":
                inner = np.add.outer([0.0, 1.0, 2.0], [0.5 - _STICKER, 0.5 + _STICKER]).ravel() / 1.5 - 1.0
                return np.array([-1.0, *inner, 1.0])
            case _:
                return np.linspace(-1.0, 1.0, 13)

    def _stickers(self, cube: Array, largest: Array) -> Array:
        """Three by three on each face, with the second colour between them."""
        rows = np.arange(len(cube))
        face = 2 * largest + (cube[rows, largest.astype(int)] < 0)
        cells = np.abs((cube * 1.5 + 1.5) % 1.0 - 0.5)
        cells[rows, largest.astype(int)] = 0.0
        colors = np.array([parse_color(text) for text in _FACES])[face.astype(int)]
        return np.where((cells.max(axis=1) > _STICKER)[:, None], np.array(self.second), colors)


def parse_color(text: str) -> Color:
    """The colour of `#rrggbb`. Raises ConfigError."""
    try:
        red, green, blue = bytes.fromhex(text.removeprefix("#"))
    except ValueError:
        raise ConfigError(f"{text!r} is no colour like #2a5fa8") from None
    return (red / 255, green / 255, blue / 255)


@cache
def object_appearance(name: str) -> ObjectAppearance:
    """The appearance of an object: by conf/appearance, else in a calm colour that depends on its name."""
    row = _table().get(name)
    if row is None:
        hue = (sum(ord(c) * (i + 7) for i, c in enumerate(name)) * 0.6180339887) % 1.0
        return ObjectAppearance(colorsys.hsv_to_rgb(hue, 0.6, 0.85), colorsys.hsv_to_rgb(hue, 0.6, 0.6))
    if row["pattern"] not in _PATTERNS:
        raise ConfigError(f"conf/appearance/objects.yaml: {name}: pattern {row['pattern']} is none of {_PATTERNS}")
    handle = None
    if "handle" in row:
        height, reach, thick = (row["handle"][key] / 1000.0 for key in ("height", "reach", "thick"))
        handle = ObjectHandle(height, reach, thick, math.radians(row["handle"]["at"]))
    return ObjectAppearance(parse_color(row["color"]), parse_color(row["second"]), row["pattern"], handle)


def series_color(number: int) -> Color:
    """The colour of a joint by its place in its finger, or of a finger by its place in the hand; for any number."""
    if number < len(_SERIES):
        return parse_color(_SERIES[number])
    return colorsys.hsv_to_rgb((number * 0.6180339887) % 1.0, 0.75, 0.7)


def lighten(color: Color) -> Color:
    """The colour half way to white, for the target of what has the colour."""
    red, green, blue = ((1.0 + part) / 2 for part in color)
    return (red, green, blue)


@cache
def _table() -> dict[str, dict[str, Any]]:
    table: dict[str, dict[str, Any]] = read_yaml(data_root() / "conf" / "appearance" / "objects.yaml")
    return table


@dataclass(frozen=True, slots=True, eq=False)
class VisualShape:
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
    """Vertices of a mesh, (k, 3), m."""
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
    def from_json(content: Mapping[str, Any]) -> VisualShape:
        mesh = "vertices" in content
        return VisualShape(
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
class VisualBody:
    """A link for drawing: its place on its parent, the joint that moves it, and its shapes."""

    name: str
    parent: int
    """Index in the list of bodies, parents first; -1 for the palm, which stands where the hand does."""
    position: tuple[float, ...]
    quaternion: tuple[float, ...]
    """On the parent at joint position zero, m; w, x, y, z."""
    joint: int = -1
    """Index in the hand's order; -1: fixed."""
    axis: tuple[float, ...] = (0.0, 0.0, 1.0)
    anchor: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Position of the joint, a hinge, in the body's own frame, m."""
    zero: float = 0.0
    """Joint position at which `position` and `quaternion` hold, rad."""
    shapes: tuple[VisualShape, ...] = ()

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
    def from_json(content: Mapping[str, Any]) -> VisualBody:
        rows: dict[str, Any] = {key: tuple(content[key]) for key in ("position", "quaternion", "axis", "anchor")}
        shapes = tuple(VisualShape.from_json(shape) for shape in content["shapes"])
        one: dict[str, Any] = {key: content[key] for key in ("name", "parent", "joint", "zero")}
        return VisualBody(shapes=shapes, **one, **rows)


def _rounded(values: tuple[float, ...]) -> list[float]:
    return [round(float(value), 7) for value in values]
