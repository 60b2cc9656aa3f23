"""A cell in viser: arm, hand and things, the same shapes as in Rerun."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import viser

from allegro_twin.hands.description.appearance import VisualBody, VisualShape
from allegro_twin.kinematics.orientation import quaternion_from_matrix
from allegro_twin.surfaces.panel.cell import CellFrame, CellOpened
from allegro_twin.surfaces.panel.page.glb import glb
from allegro_twin.types import Vector
from allegro_twin.viewing.skeleton import Skeleton
from allegro_twin.viewing.surfaces import joined, surface

EYE, AT = (0.95, -1.05, 0.75), (-0.15, 0.0, 0.2)
"""From where one looks at first, and at what, m, world."""
_STILL = 1e-4  # m, and of a quaternion: what moves by less is not sent.


class CellStage:
    """What is drawn for everybody who looks."""

    def __init__(self, server: viser.ViserServer, opened: CellOpened) -> None:
        scene, look = server.scene, opened.look
        scene.reset()
        scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), ground_color=(160, 160, 170), intensity=1.6)
        self._server, self._placed = server, dict[str, Vector]()
        self._nodes: dict[str, Any] = {}
        links = {"/arm": (opened.arm, look["arm"]), "/tool": (opened.hand, look["hand"])}
        self._chains: dict[str, Skeleton] = {}
        for root, (spec, bodies) in links.items():
            self._chains[root] = Skeleton([VisualBody.from_json(body) for body in bodies], spec)
            self._node(root)
            for body in self._chains[root].bodies:
                name = root if body.parent < 0 else f"{root}/{body.name}"
                self._node(name)
                self._mesh(f"{name}/look", body.shapes)
        for name in ("/flange", "/goal"):
            self._node(name)
        self._mesh("/flange/look", [VisualShape.from_json(shape) for shape in look["adapter"]])
        for number, shapes in enumerate(look["objects"].values()):
            self._node(f"/object_{number}")
            self._mesh(f"/object_{number}/look", [VisualShape.from_json(shape) for shape in shapes])
        self._mesh("/fixed", [VisualShape.from_json(shape) for shape in look["fixed"]])
        self._place("/arm", np.array([*look["base"], 1.0, 0.0, 0.0, 0.0]))
        camera = server.initial_camera
        camera.position, camera.look_at, camera.up = np.array(EYE), np.array(AT), np.array([0.0, 0.0, 1.0])

    def show(self, frame: CellFrame) -> None:
        """Put everything where it is."""
        with self._server.atomic():
            for name in ("flange", "tool"):
                self._place(f"/{name}", frame.poses[name])
            for number, pose in enumerate(frame.poses["objects"].reshape(-1, 7)):
                self._place(f"/object_{number}", pose)
            for root, position in (("/arm", frame.arm), ("/tool", frame.hand)):
                chain = self._chains[root]
                for body, (place, rotation) in zip(chain.bodies, chain.places(position[None]), strict=True):
                    if body.parent >= 0:
                        turn = quaternion_from_matrix(rotation[0])
                        self._place(f"{root}/{body.name}", np.concatenate([place[0], turn]))

    def _node(self, name: str) -> None:
        if name not in self._nodes:
            self._nodes[name] = self._server.scene.add_frame(name, show_axes=False)

    def _place(self, name: str, pose: Vector) -> None:
        before = self._placed.get(name)
        if before is not None and np.abs(pose - before).max() < _STILL:
            return
        self._placed[name] = np.array(pose)
        node = self._nodes[name]
        node.position, node.wxyz = pose[:3], pose[3:]

    def _mesh(self, name: str, shapes: Sequence[VisualShape]) -> None:
        if shapes:
            whole = joined([surface(shape) for shape in shapes])
            self._server.scene.add_glb(name, glb(whole), cast_shadow=False, receive_shadow=False)
