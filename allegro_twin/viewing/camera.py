"""A camera in a simulated scene, with or without a screen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.sim.model.joints import PostureMap
from allegro_twin.sim.renderer import rendering_hint
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array
from allegro_twin.viewing.gl_context import TO_LIGHT, OffscreenRenderer
from allegro_twin.viewing.overlays import Mark
from allegro_twin.viewing.views import DEFAULT, Aim, View, aimed_view

Picture = NDArray[np.uint8]
"""Rows, columns, RGB."""
_SHADOWS = 0.7
"""In distances of the eye, how far from the middle of the scene there are shadows."""
_AZIMUTHS, _SKETCH, _BETTER, _UNTURNED = 8, 96, 1.2, 0.2
"""Azimuths that are tried for a still of a grip, pixels of such a trial each way, the gain that is worth a turn, and by
how much the palm has to turn (entries of its rotation) before others are tried."""
_LEVER, _MOVED = 0.05, 5e-4  # m: a pixel of a still is some 0.8 mm, and what turns turns about so far away.
_BESIDE, _STEEP = -35.0, np.radians(70.0)
"""Degrees that the key light is turned from the eye about the vertical, and how steeply it falls: shadows are in sight
from everywhere, behind what casts them."""


class Scene(Protocol):
    """Scene to render: a backend, or one simulation of a batch."""

    @property
    def spec(self) -> HandSpec: ...
    @property
    def model(self) -> mujoco.MjModel: ...
    @property
    def data(self) -> mujoco.MjData: ...


class Camera:
    """Takes pictures of a scene, looking at the middle of the grasp and following the palm.

    `view` is a View or the name of one (`viewing.views`), and `aside` turns it about the
    vertical, degrees. `turn` leaves that azimuth. Without `shadows` a picture takes a quarter of the time. `marks` says
    what is marked in each picture. Raises ConfigError where nothing can be rendered.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        width: int = 480,
        height: int = 480,
        view: str | View = DEFAULT,
        aside: float = 0.0,
        shadows: bool = True,
        marks: Callable[[], Sequence[Mark]] = tuple,
    ) -> None:
        self._scene, self._eye, self._marks = scene, mujoco.MjvCamera(), marks
        self._root = scene.model.body(scene.spec.root).id
        self._aim, place = _looking(scene, view)
        place = replace(place, azimuth=place.azimuth + aside)
        direction = place.direction(scene.spec.side)
        self._eye.distance, self._eye.elevation = place.distance, place.elevation
        self._azimuth = self._eye.azimuth = float(np.degrees(np.arctan2(direction[1], direction[0])))
        self._side = -1.0 if scene.spec.side == "left" else 1.0
        self._step, self._edge = 0, min(_SKETCH, width, height)
        self._turned: Array | None = None
        self._still: tuple[Array, Picture] | None = None
        try:
            self._screen = OffscreenRenderer(scene.model, height, width, shadows=_SHADOWS * place.distance)
        except (ImportError, AttributeError, RuntimeError, OSError, mujoco.FatalError) as error:
            raise ConfigError(f"cannot render: {rendering_hint()} ({str(error).strip().splitlines()[0]})") from error
        if not shadows:
            self._screen.omit_shadows()

    def take(self, marks: Sequence[Mark] = ()) -> Picture:
        """The scene as it is now, and what is marked in it; further `marks` in this picture alone."""
        return self._screen.draw(self._scene.data, self._aimed(), (*self._marks(), *marks))

    def take_still(self, objects: Sequence[str]) -> Picture:
        """The grip on objects, from where most of it is seen. While nothing moves by a pixel it is the same array."""
        data = self._scene.data
        poses = np.hstack([data.geom_xpos, _LEVER * data.geom_xmat])
        if self._still is None or np.abs(poses - self._still[0]).max() > _MOVED:
            self.turn(objects)
            self._still = poses, self.take()
        return self._still[1]

    def take_depth(self) -> NDArray[np.float32]:
        """How far everything is, rows and columns, m."""
        return self._screen.draw_depth(self._scene.data, self._aimed())

    def turn(self, objects: Sequence[str]) -> None:
        """Turn about the vertical to where most of a grip is seen: of eight azimuths the one with the largest sum of
        two shares, of the objects' pixels and of the fingertips', each of the most that any azimuth shows. The azimuth
        stays unless another shows a fifth more; and while the palm has not turned."""
        palm = self._scene.data.xmat[self._root]
        if self._turned is not None and np.abs(palm - self._turned).max() < _UNTURNED:
            return
        self._turned = palm.copy()
        seen = np.array([self._pixels(step, objects) for step in range(_AZIMUTHS)], dtype=float)  # (azimuths, 1 + f)
        most = seen.max(axis=0)
        shares = np.divide(seen, most, out=np.zeros_like(seen), where=most > 0.0)
        score = shares[:, 0] + shares[:, 1:].mean(axis=1) if shares.shape[1] > 1 else shares[:, 0]
        best = int(score.argmax())
        if score[best] > _BETTER * score[self._step]:
            self._step = best
        self._face(self._step)

    def close(self) -> None:
        self._screen.close()

    def _face(self, step: int) -> None:
        self._eye.azimuth = self._azimuth + self._side * step * 360.0 / _AZIMUTHS

    def _pixels(self, step: int, objects: Sequence[str]) -> list[int]:
        """How many show the objects, and the last link of each finger."""
        model, spec = self._scene.model, self._scene.spec
        self._face(step)
        geoms = self._screen.draw_segments(self._scene.data, self._aimed(), self._edge)
        bodies = model.geom_bodyid[geoms[geoms >= 0]]
        roots = [model.body_rootid[model.body(name).id] for name in objects]
        tips = [model.site(finger.tip).bodyid[0] for finger in spec.fingers]
        return [int(np.isin(model.body_rootid[bodies], roots).sum()), *(int((bodies == tip).sum()) for tip in tips)]

    def _aimed(self) -> mujoco.MjvCamera:
        data = self._scene.data
        middle = data.xpos[self._root] + data.xmat[self._root].reshape(3, 3) @ self._aim.middle
        self._eye.lookat = middle
        beside = np.radians(self._eye.azimuth + self._side * _BESIDE)
        ahead = np.array([np.cos(beside) * np.cos(_STEEP), np.sin(beside) * np.cos(_STEEP), -np.sin(_STEEP)])
        self._screen.key_light = middle - TO_LIGHT * ahead, ahead
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
