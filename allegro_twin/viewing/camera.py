"""A camera in a simulated scene, with or without a screen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.sim.model.joints import PostureMap
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array
from allegro_twin.viewing.gl_context import OffscreenRenderer
from allegro_twin.viewing.overlays import Mark
from allegro_twin.viewing.views import DEFAULT, Aim, View, aimed_view

Picture = NDArray[np.uint8]
"""Rows, columns, RGB."""
_HINT = "headless rendering needs EGL: apt-get install libegl1 libopengl0 libgl1-mesa-dri, or set MUJOCO_GL"


class Scene(Protocol):
    """What can be looked at: a backend, or one simulation of a batch."""

    @property
    def spec(self) -> HandSpec: ...
    @property
    def model(self) -> mujoco.MjModel: ...
    @property
    def data(self) -> mujoco.MjData: ...


class Camera:
    """Takes pictures of a scene, looking at the middle of the grasp and following the palm.

    `view` is a View or the name of one (`viewing.views`), and `aside` turns it about the
    vertical, degrees. Raises ConfigError where nothing can be rendered.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        width: int = 480,
        height: int = 480,
        view: str | View = DEFAULT,
        aside: float = 0.0,
    ) -> None:
        self._scene, self._eye = scene, mujoco.MjvCamera()
        self._root = scene.model.body(scene.spec.root).id
        self._aim, place = _looking(scene, view)
        place = replace(place, azimuth=place.azimuth + aside)
        direction = place.direction(scene.spec.side)
        self._eye.distance, self._eye.elevation = place.distance, place.elevation
        self._eye.azimuth = float(np.degrees(np.arctan2(direction[1], direction[0])))
        screen = scene.model.vis.global_
        screen.offwidth, screen.offheight = max(screen.offwidth, width), max(screen.offheight, height)
        try:
            self._screen = OffscreenRenderer(scene.model, height, width)
        except (ImportError, AttributeError, RuntimeError, OSError, mujoco.FatalError) as error:
            raise ConfigError(f"cannot render: {_HINT} ({str(error).strip().splitlines()[0]})") from error

    def take(self, marks: Sequence[Mark] = ()) -> Picture:
        """The scene as it is now, and what is marked in it."""
        return self._screen.draw(self._scene.data, self._aimed(), marks)

    def take_depth(self) -> NDArray[np.float32]:
        """How far everything is, rows and columns, m."""
        return self._screen.draw_depth(self._scene.data, self._aimed())

    def close(self) -> None:
        self._screen.close()

    def _aimed(self) -> mujoco.MjvCamera:
        data = self._scene.data
        self._eye.lookat = data.xpos[self._root] + data.xmat[self._root].reshape(3, 3) @ self._aim.middle
        return self._eye


def _looking(scene: Scene, name: str | View) -> tuple[Aim, View]:
    """What to look at and from where, by the scene as it is built: the same whatever has happened in it."""
    spec, model, data = scene.spec, scene.model, mujoco.MjData(scene.model)
    palm = model.body(spec.root).id
    last = [model.site(finger.tip).bodyid[0] for finger in spec.fingers]
    posed = PostureMap(spec, model)

    def distal(posture: Array) -> Array:
        posed(posture, data.qpos)
        mujoco.mj_kinematics(model, data)
        places: Array = (data.xpos[last] - data.xpos[palm]) @ data.xmat[palm].reshape(3, 3)
        return places

    straight = distal(np.clip(np.zeros(spec.n_joints), spec.lower, spec.upper))
    bent = distal((spec.lower + spec.upper) / 2)
    return aimed_view(name, spec.side, straight, bent, data.xmat[palm].reshape(3, 3))
