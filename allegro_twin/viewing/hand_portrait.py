"""A picture and a film of a hand by itself: a colour for each finger, a number at each joint that is driven."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.hands.description.appearance import series_color
from allegro_twin.sim.model.joints import PostureMap, motor_joints
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector
from allegro_twin.viewing.camera import Picture
from allegro_twin.viewing.films import film
from allegro_twin.viewing.gl_context import OffscreenRenderer, PinholeView

SIZE = 720
"""Pixels, of the picture's edges."""
SECONDS, RATE = 10.0, 20
"""Duration of the film, s, and pictures a second."""
_WIDE = np.tan(np.radians(18.0))  # Half the width of what is seen, a metre ahead.
_FILLED = 0.86  # Of the picture's width, by the hand.
_APART = 0.008  # m, between the labels of two joints.
_PLAIN = (0.62, 0.64, 0.68, 1.0)


class HandPortrait:
    """A hand without table and object, seen from in front of its palm. Raises ConfigError where nothing can be
    rendered, or where its model is missing."""

    def __init__(self, spec: HandSpec) -> None:
        self._spec = spec
        self._model = model = compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
        self._data = mujoco.MjData(model)
        self._posture = PostureMap(spec, model)
        self._rest = np.clip(np.zeros(spec.n_joints), spec.lower, spec.upper)
        self._joints = [_moved_joint(model, spec, number) for number in range(spec.n_joints)]
        for geom in range(model.ngeom):
            model.geom_matid[geom] = -1
            model.geom_rgba[geom] = self._color(int(model.geom_bodyid[geom]), model.geom_rgba[geom])
        model.vis.headlight.ambient = np.full(3, 0.35)
        self._pose(self._rest)
        self._view = self._frame()
        self._screen = OffscreenRenderer(model, SIZE, SIZE, sites=False)

    def still(self, path: Path) -> None:
        """The hand at rest, its fingers coloured and named, its driven joints numbered, as PNG."""
        self._pose(self._rest)
        picture = self._labelled(range(self._spec.n_joints))
        with atomic_file(path) as temporary:
            Image.fromarray(picture).save(temporary, "PNG")

    def film(self, path: Path) -> None:
        """Each driven joint through its range and back, one after the other, ten seconds in all. Raises ConfigError
        without PyAV."""
        film(self._frames(), path, RATE)

    def close(self) -> None:
        self._screen.close()

    def _frames(self) -> Iterator[Picture]:
        total, n = round(SECONDS * RATE), self._spec.n_joints
        for frame in range(total):
            number, phase = divmod(frame * n / total, 1.0)
            joint = int(number)
            posture = self._rest.copy()
            low, high = self._spec.lower[joint], self._spec.upper[joint]
            way = np.interp(phase, [0.0, 0.25, 0.75, 1.0], [self._rest[joint], low, high, self._rest[joint]])
            posture[joint] = way
            self._pose(posture)
            yield self._labelled([joint])

    def _pose(self, posture: Vector) -> None:
        self._posture(posture, self._data.qpos)
        mujoco.mj_forward(self._model, self._data)

    def _color(self, body: int, plain: Array) -> tuple[float, ...]:
        """The colour of a finger for what is beyond its first joint of its own; one grey for the rest."""
        if plain[3] == 0.0:
            return tuple(float(each) for each in plain)
        number = self._finger_of(body)
        return _PLAIN if number is None else (*series_color(number), 1.0)

    def _finger_of(self, body: int) -> int | None:
        chain = _ancestors(self._model, body)
        for number, finger in enumerate(self._spec.fingers):
            tip = int(self._model.site(finger.tip).bodyid[0])
            mine = _ancestors(self._model, tip)
            others = [_ancestors(self._model, int(self._model.site(each.tip).bodyid[0]))
                      for each in self._spec.fingers if each is not finger]  # fmt: skip
            own = mine - set().union(*others)
            if chain & own:
                return number
        return None

    def _frame(self) -> PinholeView:
        """From in front of the palm, a little to the side, the whole hand in the picture."""
        model, data = self._model, self._data
        palm = model.body(self._spec.root).id
        axes = data.xmat[palm].reshape(3, 3)
        geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] and model.geom_rgba[g, 3] > 0.0]
        corners = _corners(model, data, geoms)
        away = axes @ np.array([1.0, -0.45, 0.25])
        away /= np.linalg.norm(away)
        up = axes[:, 2] - away * (axes[:, 2] @ away)
        up /= np.linalg.norm(up)
        rotation = np.column_stack([np.cross(-up, -away), -up, -away])
        middle, distance = (corners.min(axis=0) + corners.max(axis=0)) / 2.0, 1.0
        for _ in range(5):  # Nearer, until what is seen is as wide as the picture.
            seen = (corners - (middle + away * distance)) @ rotation
            low, high = (seen[:, :2] / seen[:, 2:]).min(axis=0), (seen[:, :2] / seen[:, 2:]).max(axis=0)
            middle = middle + distance * (rotation[:, :2] @ ((low + high) / 2.0))
            distance *= float((high - low).max()) / (2.0 * _FILLED * _WIDE)
        return PinholeView(middle + away * distance, rotation, -_WIDE, _WIDE, -_WIDE, _WIDE)

    def _labelled(self, joints: range | list[int]) -> Picture:
        picture = Image.fromarray(self._screen.draw(self._data, self._view))
        draw, font = ImageDraw.Draw(picture), ImageFont.load_default(15)
        at: dict[tuple[int, ...], list[int]] = {}
        for number in joints:  # Those whose axes meet share a label.
            place = self._data.xanchor[self._joints[number]]
            at.setdefault(tuple(np.round(place / _APART).astype(int).tolist()), []).append(number)
        for numbers in at.values():
            place = self._data.xanchor[self._joints[numbers[0]]]
            self._text(draw, font, place, ", ".join(map(str, numbers)), (20, 20, 20))
        if len(joints) == 1:
            number = joints[0]
            draw.text((14, SIZE - 30), f"{number}: {self._spec.joints[number]}", (255, 255, 255), font, stroke_width=2,
                      stroke_fill=(0, 0, 0))  # fmt: skip
        for number, finger in enumerate(self._spec.fingers):
            place = self._data.site(finger.tip).xpos
            color = tuple(round(255 * each) for each in series_color(number))
            self._text(draw, font, place, finger.name, color, above=22)
        return np.asarray(picture)

    def _text(
        self, draw: ImageDraw.ImageDraw, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, place: Array, text: str,
        color: tuple[int, ...], above: int = 0,
    ) -> None:  # fmt: skip
        x, y, z = self._view.rotation.T @ (place - self._view.position)
        at = SIZE / 2 * (1.0 + x / z / _WIDE), SIZE / 2 * (1.0 + y / z / _WIDE) - above
        draw.text(at, text, color, font, anchor="mm", stroke_width=2, stroke_fill=(255, 255, 255))


def _corners(model: mujoco.MjModel, data: mujoco.MjData, geoms: list[int]) -> Array:
    """Corners of the shapes' bounding boxes in the world, (n, 3), m."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    found = [data.geom_xpos[g] + (model.geom_aabb[g, :3] + signs * model.geom_aabb[g, 3:])
             @ data.geom_xmat[g].reshape(3, 3).T for g in geoms]  # fmt: skip
    return np.concatenate(found)


def _ancestors(model: mujoco.MjModel, body: int) -> set[int]:
    """A body and the bodies that carry it, without the world."""
    found = set()
    while body:
        found.add(body)
        body = int(model.body_parentid[body])
    return found


def _moved_joint(model: mujoco.MjModel, spec: HandSpec, number: int) -> int:
    """The joint at which a driven one is shown: its own; of a motor on a tendon the first that follows it."""
    own = motor_joints(spec, model).get(number)
    if own is not None:
        return own
    first = next((each.name for each in spec.followers if each.driven == number), None)
    return 0 if first is None else int(model.joint(first).id)
