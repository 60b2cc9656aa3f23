"""Flat plates with a picture on them, such as a calibration pattern: seen, and never touched."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.types import Array


class PicturePlate(NamedTuple):
    """A plate on a body of the scene, or in the world."""

    name: str
    body: str | None
    """None: the world."""
    position: Array
    """Its picture's upper left corner in the body's frame, (3,), m."""
    quaternion: Array
    """w x y z: x along the picture's rows, y down its columns, z into it."""
    size: tuple[float, float]
    """Along x and y, m."""
    picture: NDArray[np.uint8]
    """Brightness, (rows, columns)."""


def add_plate(scene: mujoco.MjSpec, plate: PicturePlate) -> None:
    """Fix a plate in a scene; it weighs nothing."""
    rows, columns = plate.picture.shape
    wide, high = plate.size
    texture = scene.add_texture(name=plate.name, type=mujoco.mjtTexture.mjTEXTURE_2D)
    texture.width, texture.height, texture.nchannel = columns, rows, 3
    texture.data = np.repeat(plate.picture[..., None], 3, axis=-1).tobytes()
    look = scene.add_material(name=plate.name, specular=0.0, shininess=0.0, reflectance=0.0)
    look.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = plate.name
    corners = np.array([[0.0, 0.0, 0.0], [wide, 0.0, 0.0], [wide, high, 0.0], [0.0, high, 0.0]])
    scene.add_mesh(
        name=plate.name,
        uservert=corners.ravel(),
        userface=[0, 2, 1, 0, 3, 2],
        userfacetexcoord=[0, 2, 1, 0, 3, 2],
        usertexcoord=[0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0],
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    body = scene.worldbody if plate.body is None else scene.body(plate.body)
    body.add_geom(
        name=plate.name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=plate.name, material=plate.name, mass=0.0,
        pos=plate.position, quat=plate.quaternion, contype=0, conaffinity=0,
    )  # fmt: skip
