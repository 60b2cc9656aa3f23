"""Thumbnails: small pictures of a hand in its postures, without surroundings."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.sim.model.joints import PostureMap
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector
from allegro_twin.viewing.camera import Camera

_FINER = 3  # Times as many pixels are rendered each way; the part that shows the hand is averaged.
_ASIDE = 25.0  # Degrees past the palm, where curled fingers show.
_QUALITY = 85  # WebP's.


@dataclass(slots=True, eq=False)
class _Scene:
    """A hand alone."""

    spec: HandSpec
    model: mujoco.MjModel
    data: mujoco.MjData


@dataclass(frozen=True, slots=True)
class Thumbnails:
    """Renders postures of one hand, `size` pixels each way, all on one scale."""

    spec: HandSpec
    size: int = 96

    def open(self) -> Callable[[Vector], bytes]:
        """A function from a posture, (n,), rad, to a WebP picture with a transparent background. Raises ConfigError
        where nothing can be rendered."""
        from PIL import Image

        spec, edge = self.spec, self.size * _FINER
        model = compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
        model.light_castshadow[:] = False
        scene, pose = _Scene(spec, model, mujoco.MjData(model)), PostureMap(spec, model)
        camera = Camera(scene, width=edge, height=edge, view="palm", aside=_ASIDE)
        far = 0.99 * model.vis.map.zfar * model.stat.extent

        def mask(posture: Vector) -> NDArray[np.bool_]:
            pose(np.asarray(posture), scene.data.qpos)
            mujoco.mj_forward(model, scene.data)
            return np.asarray(camera.take_depth() < far)

        straight = np.clip(np.zeros(spec.n_joints), spec.lower, spec.upper)
        shown = np.logical_or.reduce([mask(posture) for posture in (straight, (spec.lower + spec.upper) / 2.0)])
        window = _square(shown)

        def render(posture: Vector) -> bytes:
            seen = np.where(mask(posture), 255, 0).astype(np.uint8)
            picture = Image.fromarray(np.dstack([camera.take(), seen]))
            small = picture.resize((self.size, self.size), Image.Resampling.LANCZOS, box=window)
            content = io.BytesIO()
            small.save(content, "WEBP", quality=_QUALITY)
            return content.getvalue()

        return render


def _square(shown: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Left, upper, right and lower edge of the square part of a picture that has all that is shown, pixels."""
    (top, bottom), (left, right) = ((k.min(), k.max() + 1) for k in np.nonzero(shown))
    half = min(int(0.54 * max(bottom - top, right - left)), len(shown) // 2)
    x, y = (int(np.clip((low + high) // 2, half, len(shown) - half)) for low, high in ((left, right), (top, bottom)))
    return x - half, y - half, x + half, y + half
