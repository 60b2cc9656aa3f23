"""The scene in viser: hand, arm and objects, with the shapes, colours and arrows that Rerun has."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import viser

from allegro_twin.hands.description.appearance import VisualShape, series_color
from allegro_twin.kinematics.orientation import matrix_from_quaternion, quaternion_from_matrix
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.panel.page.glb import glb
from allegro_twin.surfaces.panel.stream import SessionInfo, StreamFrame
from allegro_twin.types import Array, Vector
from allegro_twin.viewing.scenery import ArmScenery, Scenery
from allegro_twin.viewing.skeleton import Skeleton
from allegro_twin.viewing.surfaces import join_surfaces, surface_of
from allegro_twin.viewing.views import aimed_view

PALM, ARM, GOAL = "/palm", "/arm", "/object_goal"
EYE, AT = (0.95, -1.05, 0.75), (-0.15, 0.0, 0.2)
"""The first view of a cell: the place of the eye, and the point that it looks at, m, world."""
_ARROW = 0.012  # m for each newton of contact force.
_BELOW, _WIDE, _LINES = 0.14, 0.3, 13  # m under the palm, half its edge, and lines each way of the floor.
_NOWHERE = np.array([[0.0, 0.0, -50.0], [0.0, 0.0, -50.001]])  # m. An arrow needs a length.
_STILL, _ARM_STILL = 1e-5, 1e-4
"""m, and of a quaternion: what moves by less is not sent. An arm with its force sensor is never quite still."""
_PULL = (214, 110, 0)
"""Colour of the line between an object and the mouse that pulls it."""
_BENEATH = np.array([0.0, 0.0, -0.07])  # m, of the goal's label under its middle.
_ABOVE = np.array([0.0, 0.0, 0.015])  # m, of the force's label over the mouse: the line stays in sight.
OnDrag = Callable[[int, Any], None]
_ASIDE, _CLOSER = 35.0, 1.0
"""Degrees that the first view of a hand is turned past the palm, and the part of the distance of pictures."""


class SceneView:
    """The picture of one session, for all browsers."""

    def __init__(self, server: viser.ViserServer, info: SessionInfo, on_drag: OnDrag | None = None) -> None:
        """`on_drag` hears of the mouse on an object, by its number, where objects can be pulled."""
        scene, scenery = server.scene, info.scenery
        scene.reset()
        scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), ground_color=(160, 160, 170), intensity=1.6)
        self._server, self._placed = server, dict[str, Vector]()
        self._nodes: dict[str, Any] = {}
        self._still = _STILL if info.arm is None else _ARM_STILL
        self._parts = [*(finger.name for finger in info.spec.fingers), "palm"]
        self._chains = {PALM: Skeleton(scenery.bodies, info.spec)}
        if info.arm is not None and scenery.arm is not None:
            self._chains[ARM] = Skeleton(scenery.arm.bodies, info.arm)
        for root, chain in self._chains.items():
            self._node(root)
            for body in chain.bodies:
                name = root if body.parent < 0 else f"{root}/{body.name}"
                self._node(name)
                self._mesh(f"{name}/look", body.shapes)
        for number, (object_name, shapes) in enumerate(scenery.objects.items()):
            self._node(f"/object_{number}")
            mesh = self._mesh(f"/object_{number}/{object_name}", shapes)
            if mesh is not None and on_drag is not None and info.arm is None and not info.no_drag:
                mesh.on_drag("left")(_numbered(on_drag, number))
        self._goal_label: Any = None
        if info.turns:
            self._node(GOAL)
            self._mesh(f"{GOAL}/look", next(iter(scenery.objects.values())))
            self._goal_label = scene.add_label("/goal_name", "goal", visible=False)
        self._mesh("/fixed", scenery.fixed)
        self._arrows: Any = None
        self._pull: tuple[Any, Any] | None = None
        self._place(PALM, np.array(scenery.palm))
        if scenery.arm is not None:
            self._add_arm(scenery.arm)
        elif not scenery.fixed:
            lines = _floor(np.array(scenery.palm)[:3] - np.array([0.0, 0.0, _BELOW]))
            scene.add_line_segments("/floor", lines, (190, 198, 208), line_width=1.0)
        camera = server.initial_camera
        camera.position, camera.look_at = eye(info.spec, scenery)
        camera.up = np.array([0.0, 0.0, 1.0])

    def show(self, frame: StreamFrame) -> None:
        """Put everything where it is."""
        with self._server.atomic():
            look = frame.look
            for name in ("palm", "flange"):
                if name in look:
                    self._place(f"/{name}", look[name])
            if "object" in look:
                self._place("/object_0", look["object"])
            if self._goal_label is not None and "object_goal" in look:
                self._place(GOAL, look["object_goal"])
                if not self._goal_label.visible:
                    self._goal_label.position, self._goal_label.visible = look["object_goal"][:3] + _BENEATH, True
            for number, pose in enumerate(look.get("others", ())):
                self._place(f"/object_{number + 1}", pose)
            self._bend(PALM, frame.position)
            if ARM in self._chains:
                self._bend(ARM, frame.arm)
            self._press(look)
            self._show_pull(look.get("drag"))

    def pose(self, number: int) -> Vector | None:
        """Where an object is drawn, (7,); None: nowhere yet."""
        return self._placed.get(f"/object_{number}")

    def _show_pull(self, drag: Array | None) -> None:
        """A line from the picked point to the mouse, and the force in newtons."""
        if drag is None:
            for handle in self._pull or ():
                handle.visible = False
            return
        point, target, text = drag[1:4], drag[4:7], f"{np.linalg.norm(drag[7:]):.1f} N"
        above = target + _ABOVE
        line = np.array([[point, target]], dtype=np.float32)
        if self._pull is None:
            scene = self._server.scene
            self._pull = (scene.add_line_segments("/pull", line, _PULL, line_width=4.0),
                          scene.add_label("/pull_force", text, position=above))  # fmt: skip
            return
        segment, label = self._pull
        segment.points, label.text, label.position = line, text, above
        segment.visible = label.visible = True

    def _add_arm(self, arm: ArmScenery) -> None:
        self._node("/flange")
        self._mesh("/flange/look", arm.adapter)
        self._place(ARM, np.array([*arm.base, 1.0, 0.0, 0.0, 0.0]))

    def _bend(self, root: str, position: Vector) -> None:
        chain = self._chains[root]
        for body, (place, rotation) in zip(chain.bodies, chain.places(position[None]), strict=True):
            if body.parent >= 0:
                self._place(f"{root}/{body.name}", np.concatenate([place[0], quaternion_from_matrix(rotation[0])]))

    def _node(self, name: str) -> None:
        if name not in self._nodes:
            self._nodes[name] = self._server.scene.add_frame(name, show_axes=False)

    def _place(self, name: str, pose: Vector) -> None:
        before, node = self._placed.get(name), self._nodes.get(name)
        if node is None or (before is not None and np.abs(pose - before).max() < self._still):
            return
        self._placed[name] = np.array(pose)
        node.position, node.wxyz = pose[:3], pose[3:]

    def _mesh(self, name: str, shapes: Sequence[VisualShape]) -> Any:
        if not shapes:
            return None
        whole = join_surfaces([surface_of(shape) for shape in shapes])
        return self._server.scene.add_glb(name, glb(whole), cast_shadow=False, receive_shadow=False)

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


def _numbered(on_drag: OnDrag, number: int) -> Callable[[Any], Coroutine[None, None, None]]:
    """A callback of viser's for one object; viser awaits these in the order of the mouse."""

    async def dragged(event: Any) -> None:
        on_drag(number, event)

    return dragged


def _floor(middle: Vector) -> Array:
    """Lines of a net, (k, 2, 3), m: something to see what is up by."""
    steps = np.linspace(-_WIDE, _WIDE, _LINES)
    ends = np.array([-_WIDE, _WIDE])
    along = np.stack(np.broadcast_arrays(steps[:, None], ends[None], 0.0), axis=-1)
    found: Array = np.concatenate([along, along[..., [1, 0, 2]]]) + middle
    return found


def eye(spec: HandSpec, scenery: Scenery) -> tuple[Vector, Vector]:
    """The place of the eye in the first view, and the point that it looks at, (3,), m, world."""
    if scenery.arm is not None:
        return np.array(EYE), np.array(AT)
    palm = np.array(scenery.palm)
    turn = matrix_from_quaternion(palm[3:])
    target, palm_on = aimed_view("palm", spec.side, *Skeleton(scenery.bodies, spec).tips(), turn)
    view = replace(palm_on, azimuth=palm_on.azimuth + _ASIDE)
    middle = palm[:3] + turn @ target.middle
    return middle - _CLOSER * view.distance * view.direction(spec.side), middle
