"""Camera mount: the body or site of the scene, or the world, that a camera is fixed to, and its pose there."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.schema import Settings, Vector3
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.types import Array


class CameraPose(NamedTuple):
    """The camera in the world; its own axes are x right, y down, z ahead."""

    position: Array
    """(3,), m."""
    rotation: Array
    """Its axes in the world, columns of (3, 3)."""

    def world(self, points: Array) -> Array:
        """Points (..., 3) of the camera's frame in the world, m."""
        return np.asarray(points @ self.rotation.T + self.position)


class CameraMount(Settings):
    """Pose of a camera in the frame of a body or a site; in the world where neither is named."""

    body: str | None = None
    site: str | None = None
    position: Vector3
    """Position of the left imager, m."""
    quaternion: tuple[float, float, float, float] | None = None
    """Orientation of the camera's axes (x right, y down, z ahead) in the frame that it stands in: w, x, y, z; as
    calibrations have it."""
    towards: Vector3 | None = None
    """Point in that frame that the middle of the view goes through, m; instead of `quaternion`."""
    up: Vector3 = (0.0, 0.0, 1.0)
    """Direction in that frame that is up in the picture; with `towards`."""

    @model_validator(mode="after")
    def _one_way(self) -> CameraMount:
        if self.body is not None and self.site is not None:
            raise ValueError(f"camera: mount on body {self.body!r} or on site {self.site!r}, not on both")
        if (self.quaternion is None) == (self.towards is None):
            raise ValueError("camera: give the mount either a quaternion or a point `towards` which it looks")
        self.local()
        return self

    def local(self) -> CameraPose:
        """In the frame that it stands in."""
        if self.quaternion is not None:
            return CameraPose(np.array(self.position), matrix_from_quaternion(self.quaternion))
        assert self.towards is not None
        return looking(self.position, self.towards, self.up)

    def pose(self, model: mujoco.MjModel, data: mujoco.MjData) -> CameraPose:
        """In the world, as the scene is now. Raises ConfigError for a body or site that is not there."""
        at, turn = self._frame(model, data)
        local = self.local()
        return CameraPose(at + turn @ local.position, turn @ local.rotation)

    def _frame(self, model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
        for kind, name, places, turns in (
            (mujoco.mjtObj.mjOBJ_BODY, self.body, data.xpos, data.xmat),
            (mujoco.mjtObj.mjOBJ_SITE, self.site, data.site_xpos, data.site_xmat),
        ):
            if name is not None:
                number = mujoco.mj_name2id(model, kind.value, name)
                if number < 0:
                    raise ConfigError(f"camera: {unknown(*_all(model, kind, name))}")
                return places[number].copy(), turns[number].reshape(3, 3).copy()
        return np.zeros(3), np.eye(3)


def looking(position: ArrayLike, towards: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> CameraPose:
    """A camera at a place (3,) that looks at a point (3,), m, with `up` (3,) up in its picture.

    Raises ConfigError where it would look along `up`, or at where it is itself.
    """
    place, way = np.asarray(position, dtype=np.float64), np.asarray(towards, dtype=np.float64)
    ahead = way - place
    if not ahead.any():
        raise ConfigError(
            f"camera at {place.tolist()}: `towards` is the same point, which says no direction; "
            "give one that differs from `position`"
        )
    right = np.cross(ahead, np.asarray(up, dtype=np.float64))
    if not np.linalg.norm(right) > 1e-6 * np.linalg.norm(ahead):
        raise ConfigError(f"camera at {place.tolist()}: it looks at {way.tolist()}, along its `up`; give another `up`")
    z, x = ahead / np.linalg.norm(ahead), right / np.linalg.norm(right)
    return CameraPose(place, np.stack([x, np.cross(z, x), z], axis=1))


def _all(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str) -> tuple[str, str, list[str]]:
    what, count = ("body", model.nbody) if kind == mujoco.mjtObj.mjOBJ_BODY else ("site", model.nsite)
    return what, name, [mujoco.mj_id2name(model, kind.value, k) or "" for k in range(count)]
