"""The look of an object on its geoms: a pattern wrapped around it, and a handle that is seen and never touched."""

from __future__ import annotations

import math
from functools import cache
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np

from allegro_twin.hands.description.appearance import object_appearance
from allegro_twin.types import Array

_EDGE = 96  # Texels along an edge of each of a cube's six sides.
_SEGMENTS = 6
# MuJoCo's order of a cube's sides, and on each the directions of the picture's right and down, as OpenGL has them.
_SIDES = (
    ((1, 0, 0), (0, 0, -1), (0, -1, 0)),
    ((-1, 0, 0), (0, 0, 1), (0, -1, 0)),
    ((0, 1, 0), (1, 0, 0), (0, 0, 1)),
    ((0, -1, 0), (1, 0, 0), (0, 0, -1)),
    ((0, 0, 1), (1, 0, 0), (0, -1, 0)),
    ((0, 0, -1), (-1, 0, 0), (0, -1, 0)),
)


def geom_look(spec: mujoco.MjSpec, name: str) -> dict[str, Any]:
    """The attributes of a geom that make it look like the object of a name."""
    look = object_appearance(name)
    if look.pattern == "plain":
        return {"rgba": [*look.color, 1.0]}
    material = f"{name}_look"
    if spec.material(material) is None:
        texture = spec.add_texture(name=material, type=mujoco.mjtTexture.mjTEXTURE_CUBE)
        texture.width, texture.height, texture.nchannel = _EDGE, 6 * _EDGE, 3
        texture.data = _texels(name)
        made = spec.add_material(name=material)
        made.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = material
    return {"material": material}


def add_handle(body: mujoco.MjsBody, name: str, radius: float) -> None:
    """Add the object's handle, if it has one, to the side of a cylinder of a radius (m): half a ring, without mass."""
    shown = object_appearance(name).handle
    if shown is None:
        return
    turns = np.linspace(-math.pi / 2, math.pi / 2, _SEGMENTS + 1)
    out = radius - shown.thick / 2 + shown.reach * np.cos(turns)
    ring = np.stack([out * math.cos(shown.at), out * math.sin(shown.at), shown.height / 2 * np.sin(turns)], axis=1)
    for first, last in pairwise(ring):
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[*first, *last], size=[shown.thick / 2, 0, 0],
            contype=0, conaffinity=0, mass=0.0, group=1, rgba=[*object_appearance(name).color, 1.0],
        )  # fmt: skip


@cache
def _texels(name: str) -> bytes:
    """The six sides of the cube of an object's look, one after the other: the same in every scene."""
    look = object_appearance(name)
    colors = np.concatenate([look.paint(_directions(*side)) for side in _SIDES])
    return np.round(255 * colors).astype(np.uint8).tobytes()


def _directions(middle: tuple[int, ...], right: tuple[int, ...], down: tuple[int, ...]) -> Array:
    """Where the texels of one side lie on a cube of half-extent 1, rows first, (k, 3)."""
    steps = (np.arange(_EDGE) + 0.5) / _EDGE * 2 - 1
    rows, columns = np.meshgrid(steps, steps, indexing="ij")
    places = np.array(middle) + columns[..., None] * np.array(right) + rows[..., None] * np.array(down)
    found: Array = places.reshape(-1, 3).astype(np.float64)
    return found
