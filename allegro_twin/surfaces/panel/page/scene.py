"""The hand and its scene in viser: the same shapes, colours and arrows as in Rerun."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import viser

from allegro_twin.hands.description.appearance import VisualShape, series_color
from allegro_twin.kinematics.orientation import matrix_from_quaternion, quaternion_from_matrix
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.panel.page.glb import glb
from allegro_twin.surfaces.panel.stream import Frame, Opened
from allegro_twin.types import Array, Vector
from allegro_twin.viewing.scenery import Scenery
from allegro_twin.viewing.skeleton import Skeleton
from allegro_twin.viewing.surfaces import joined, surface
from allegro_twin.viewing.views import seen

PALM = "/palm"
_ARROW = 0.012  # m for each newton of contact force.
_BELOW, _WIDE, _LINES = 0.14, 0.3, 13  # m under the palm, half its edge, and lines each way of the floor.
_NOWHERE = np.array([[0.0, 0.0, -50.0], [0.0, 0.0, -50.001]])  # m. An arrow needs a length.
_STILL = 1e-5  # m, and of a quaternion: what moves by less is not sent.
_ASIDE, _CLOSER = 35.0, 1.0
"""Degrees that one looks past the palm, and parts of the distance of pictures."""


class Stage:
    """What is drawn of one opening of a hand, for everybody who looks."""

    def __init__(self, server: viser.ViserServer, opened: Opened) -> None:
        scene, scenery = server.scene, opened.scenery
        scene.reset()
        scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), ground_color=(160, 160, 170), intensity=1.6)
        self._server, self._skeleton = server, Skeleton(scenery.bodies, opened.spec)
        self._parts = [*(finger.name for finger in opened.spec.fingers), "palm"]
        self._placed: dict[str, Vector] = {}
        palm = np.array(scenery.palm)
        self._nodes: dict[str, Any] = {PALM: scene.add_frame(PALM, show_axes=False)}
        for body in scenery.bodies:
            name = PALM if body.parent < 0 else f"{PALM}/{body.name}"
            if body.parent >= 0:
                self._nodes[name] = scene.add_frame(name, show_axes=False)
            self._mesh(f"{name}/look", body.shapes)
        for number, (thing, shapes) in enumerate(scenery.objects.items()):
            name = f"/object_{number}"
            self._nodes[name] = scene.add_frame(name, show_axes=False)
            self._mesh(f"{name}/{thing}", shapes)
        self._mesh("/fixed", scenery.fixed)
        if not scenery.fixed:
            lines = _floor(palm[:3] - np.array([0.0, 0.0, _BELOW]))
            scene.add_line_segments("/floor", lines, (190, 198, 208), line_width=1.0)
        self._arrows: Any = None
        self._place(PALM, palm)
        _aim(server, opened, scenery)

    def show(self, frame: Frame) -> None:
        """Put everything where it is."""
        with self._server.atomic():
            look = frame.look
            if "palm" in look:
                self._place(PALM, look["palm"])
            if "object" in look:
                self._place("/object_0", look["object"])
            for number, pose in enumerate(look.get("others", ())):
                self._place(f"/object_{number + 1}", pose)
            places = self._skeleton.places(frame.position[None])
            for body, (place, rotation) in zip(self._skeleton.bodies, places, strict=True):
                if body.parent >= 0:
                    turn = quaternion_from_matrix(rotation[0])
                    self._place(f"{PALM}/{body.name}", np.concatenate([place[0], turn]))
            self._press(look)

    def _place(self, name: str, pose: Vector) -> None:
        before, node = self._placed.get(name), self._nodes.get(name)
        if node is None or (before is not None and np.abs(pose - before).max() < _STILL):
            return
        self._placed[name] = np.array(pose)
        node.position, node.wxyz = pose[:3], pose[3:]

    def _mesh(self, name: str, shapes: Sequence[VisualShape]) -> None:
        if not shapes:
            return
        whole = joined([surface(shape) for shape in shapes])
        self._server.scene.add_glb(name, glb(whole), cast_shadow=False, receive_shadow=False)

    def _press(self, look: Mapping[str, Array]) -> None:
        """An arrow for each part that presses on the object, towards where it does."""
        points = look.get("contact_point", np.full(3 * len(self._parts), np.nan)).reshape(-1, 3)
        vectors = look.get("contact_vector", np.zeros(points.size)).reshape(-1, 3)
        there = np.asarray(np.isfinite(points).all(axis=1))
        if not there.any():
            if self._arrows is not None:
                self._arrows.visible = False
            return
        ends = np.where(there[:, None], points, 0.0)
        rows = np.stack([ends - _ARROW * np.where(there[:, None], vectors, 0.0), ends], axis=1)
        rows[~there] = _NOWHERE
        if self._arrows is None:
            colors = np.array([[round(255 * c) for c in series_color(k)] for k in range(len(rows))], dtype=np.uint8)
            self._arrows = self._server.scene.add_arrows(
                "/contact", rows, colors,
                shaft_radius=0.0015, head_radius=0.004, head_length=0.009,
            )  # fmt: skip
        else:
            self._arrows.points, self._arrows.visible = rows.astype(np.float32), True


def _floor(middle: Vector) -> Array:
    """Lines of a net, (k, 2, 3), m: something to see what is up by."""
    steps = np.linspace(-_WIDE, _WIDE, _LINES)
    ends = np.array([-_WIDE, _WIDE])
    along = np.stack(np.broadcast_arrays(steps[:, None], ends[None], 0.0), axis=-1)
    found: Array = np.concatenate([along, along[..., [1, 0, 2]]]) + middle
    return found


def _aim(server: viser.ViserServer, opened: Opened, scenery: Scenery) -> None:
    camera = server.initial_camera
    camera.position, camera.look_at = eye(opened.spec, scenery)
    camera.up = np.array([0.0, 0.0, 1.0])


def eye(spec: HandSpec, scenery: Scenery) -> tuple[Vector, Vector]:
    """Where one begins to look from, and at what, (3,), m, world: on the palm, from aside."""
    palm = np.array(scenery.palm)
    turn = matrix_from_quaternion(palm[3:])
    target, palm_on = seen("palm", spec.side, *Skeleton(scenery.bodies, spec).tips(), turn)
    view = replace(palm_on, azimuth=palm_on.azimuth + _ASIDE)
    middle = palm[:3] + turn @ target.middle
    return middle - _CLOSER * view.distance * view.direction(spec.side), middle
