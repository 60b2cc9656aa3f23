"""A hand on a gantry that can be anywhere, beside an object where it stands: what touches what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.sim.model.joints import PostureMap
from allegro_twin.sim.model.parts import body_parts
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.sim.model.wrist import WRIST_JOINTS, wrist_angles
from allegro_twin.sim.objects.catalogue import PlacedObject
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

Indices = NDArray[np.int_]


class TouchPoints(NamedTuple):
    """Contact points of hand and object, a row each: their geometry, without forces."""

    points: Array
    """(k, 3), m, world."""
    normals: Array
    """Into the object, (k, 3)."""
    part: Indices
    """Which finger, or the palm, (k,)."""
    depth: Array
    """How deep, (k,), m."""
    body: Indices
    """Body of the hand at each contact, (k,)."""


class GraspScene:
    """One model for every pose of the palm: its wrist's coordinates are the pose."""

    def __init__(self, spec: HandSpec, around: Stage, begun: Sequence[float] | None = None) -> None:
        """`begun`: where the object's middle is when a trial begins, (3,), m, if it is pushed to where it is here."""
        around = replace(around, position=np.zeros(3), quaternion=np.array([1.0, 0.0, 0.0, 0.0]))
        self.spec, self._edge = spec, around.edge
        self.placed: PlacedObject = around.objects[0]
        """The object where it stands."""
        self.model = model = compile_scene(spec, around)
        self.data = mujoco.MjData(model)
        self.name = self.placed.grasp_object.name
        self.begun = np.array(self.placed.position if begun is None else begun)
        """Where the object's middle is at first, (3,), m: from there scenarios count."""
        self.body = int(model.body(self.name).id)
        self._posed = PostureMap(spec, model)
        self.motors = self._posed.motors
        """Motor that moves each moving joint, (joints,)."""
        self._wrist = [int(model.joint(name).qposadr[0]) for name in WRIST_JOINTS]
        self.part = body_parts(model, spec)[model.geom_bodyid]
        """Which part of the hand each geom belongs to; -1: none."""
        self._carry = _carrying(model, self._posed.joints)
        self._of_object = model.geom_bodyid == self.body
        self._columns = [] if spec.followers else [int(model.joint(name).dofadr[0]) for name in spec.joints]
        self._hand = np.flatnonzero((self.part >= 0) & ((model.geom_contype | model.geom_conaffinity) != 0))

    @property
    def mass(self) -> float:
        """Mass of the object, kg."""
        return float(self.model.body_mass[self.body])

    @property
    def centre(self) -> Array:
        """Its centre of mass, world, (3,), m."""
        centre: Array = self.data.xipos[self.body].copy()
        return centre

    def place(self, position: Array, rotation: Array, posture: Vector) -> None:
        """Put the palm somewhere, the fingers in a posture (n,), rad, and find what touches."""
        self._move(position, rotation, posture)
        self._collide()

    def carry(self, position: Array, rotation: Array) -> None:
        """Put the palm somewhere; `bend_each` is to follow."""
        self.data.qpos[self._wrist] = wrist_coordinates(position, rotation)

    def bend_each(self, motors: Vector) -> None:
        """With the palm where it is, every joint where its motor would have it at `motors`, (joints,), rad; find what
        touches."""
        self._posed.each(motors, self.data.qpos)
        mujoco.mj_kinematics(self.model, self.data)
        self._collide()

    def lowest(self, position: Array, rotation: Array, posture: Vector) -> float:
        """Height of the hand's lowest point over the table, by the bounding boxes of its shapes, m; inf where all of it
        is beyond the edge."""
        self._move(position, rotation, posture)
        low, _ = self._bounds(self._hand)
        return float(low[low[:, 0] < self._edge, 2].min(initial=np.inf))

    @property
    def foremost(self) -> float:
        """The object's largest x, by the bounding boxes of its shapes, m."""
        return float(self._bounds(np.flatnonzero(self._of_object))[1][:, 0].max())

    def _bounds(self, geoms: Indices) -> tuple[Array, Array]:
        """Lowest and highest corners of the boxes around some geoms along the world's axes, (k, 3) each, m."""
        box, turn = self.model.geom_aabb[geoms], self.data.geom_xmat[geoms].reshape(-1, 3, 3)
        centre = self.data.geom_xpos[geoms] + np.einsum("gij,gj->gi", turn, box[:, :3])
        half = np.einsum("gij,gj->gi", np.abs(turn), box[:, 3:])
        return centre - half, centre + half

    def _move(self, position: Array, rotation: Array, posture: Vector) -> None:
        self._posed(posture, self.data.qpos)
        self.carry(position, rotation)
        mujoco.mj_kinematics(self.model, self.data)

    def _collide(self) -> None:
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)

    def meets_anything(self) -> bool:
        """Whether the hand touches the object, or what it stands on."""
        return bool(self._pairs()[2].any())

    def overlap(self) -> float:
        """How deep the hand is inside itself, m."""
        geoms, depth = self.data.contact.geom, -self.data.contact.dist
        return float(depth[(self.part[geoms] >= 0).all(axis=1)].max(initial=0.0))

    def stopped(self) -> NDArray[np.bool_]:
        """The joints that carry something of the hand that touches something else, (joints,)."""
        if not self.data.ncon:
            return np.zeros(self._carry.shape[1], dtype=bool)
        first, second, foreign = self._pairs()
        hand = np.where(self.part[first] >= 0, first, second)[foreign]
        return np.asarray(self._carry[hand].any(axis=0))

    def meets_table(self) -> bool:
        """Whether the hand touches what stands still."""
        first, second, foreign = self._pairs()
        other = np.where(self.part[first] >= 0, second, first)[foreign]
        return bool((~self._of_object[other]).any())

    def touch(self, data: mujoco.MjData | None = None) -> TouchPoints:
        """Where hand and object touch; of another state of the same model, if one is given."""
        contact = (self.data if data is None else data).contact
        first, second = contact.geom[:, 0], contact.geom[:, 1]
        at_second = self._of_object[second] & (self.part[first] >= 0)
        mine = at_second | (self._of_object[first] & (self.part[second] >= 0))
        sign = np.where(at_second, 1.0, -1.0)[mine, None]
        hand = np.where(at_second, first, second)[mine]
        normals = sign * contact.frame[mine, :3]
        bodies = self.model.geom_bodyid[hand]
        return TouchPoints(contact.pos[mine], normals, self.part[hand], -contact.dist[mine], bodies)

    def jacobians(self, touch: TouchPoints, data: mujoco.MjData | None = None) -> Array:
        """How each contact of the hand moves with its joints, (k, 3, n), m/rad, world; for a hand whose motors turn a
        joint each."""
        moved, found = np.zeros((3, self.model.nv)), np.empty((len(touch.points), 3, len(self._columns)))
        for row, (point, body) in enumerate(zip(touch.points, touch.body.tolist(), strict=True)):
            mujoco.mj_jac(self.model, self.data if data is None else data, moved, None, point, body)
            found[row] = moved[:, self._columns]
        return found

    def _pairs(self) -> tuple[Indices, Indices, NDArray[np.bool_]]:
        geoms = self.data.contact.geom
        first, second = geoms[:, 0], geoms[:, 1]
        return first, second, (self.part[first] >= 0) != (self.part[second] >= 0)


def wrist_coordinates(position: Array, rotation: Array) -> Array:
    """The wrist's six coordinates of a palm: slides, then angles."""
    return np.concatenate([position, wrist_angles(rotation)])


def _carrying(model: mujoco.MjModel, joints: list[int]) -> NDArray[np.bool_]:
    """Which of some joints carry each geom, (geoms, joints)."""
    found = np.zeros((model.nbody, len(joints)), dtype=bool)
    for body in range(1, model.nbody):  # Parents come first.
        found[body] = found[model.body_parentid[body]] | (model.jnt_bodyid[joints] == body)
    carried: NDArray[np.bool_] = found[model.geom_bodyid]
    return carried
