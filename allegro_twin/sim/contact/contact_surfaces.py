"""Contact surfaces of each digit: fingertips, pads, sides, inner links, the palm."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from allegro_twin.sim.model.parts import Indices, body_parts, part_names
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

SURFACES = ("tip", "pad", "inner", "side", "back", "palm")
"""Surfaces that bear on an object: of a digit's last link the end (tip) and the face (pad); of the links before it the
face (inner); of any link a side or the back; and the palm."""
_TIP, _PAD, _INNER, _SIDE, _BACK, _PALM = range(len(SURFACES))
_SIDEWAYS, _CAP = float(np.cos(np.radians(45.0))), float(np.cos(np.radians(60.0)))
"""Cosines of the angles within which a link bears with its side, between contact normal and last joint's axis, and a
digit with its tip, between normal and last link: the cap of a round one, 60° about its end. Assumed."""


class SurfaceForces(NamedTuple):
    """Contact forces between hand and object at one moment, summed by part of the hand and surface. The palm's
    frame."""

    force: Array
    """Normal force, (parts, surfaces), N."""
    normal: Array
    """Σ normal force · its direction, into the object, (parts, surfaces, 3), N."""
    point: Array
    """Σ normal force · where, (parts, surfaces, 3), N·m."""


class DigitPose(NamedTuple):
    """Pose of the digits at one moment, in the order of the spec's fingers. The palm's frame."""

    direction: Array
    """From each digit's root to its tip, (d, 3), unit."""
    length: Vector
    """Length of each digit along its links, (d,), m."""
    straight: Vector
    """How far root and tip are apart, as a share of that length, (d,)."""


class BodyPlaces(NamedTuple):
    """Poses of bodies and sites in a state, under the names that MuJoCo's data have: what `stance` needs, to keep."""

    xpos: Array
    xmat: Array
    site_xpos: Array

    @classmethod
    def of(cls, data: mujoco.MjData) -> BodyPlaces:
        return cls(data.xpos.copy(), data.xmat.copy(), data.site_xpos.copy())


class SurfaceProbe:
    """Looks into a scene at one object, contact by contact.

    A digit's palmar face is the one that its last joint moves ahead when it flexes: towards the farther end of its
    range, as a finger bends far and extends little. Where the range says nothing, a digit has no back.
    """

    def __init__(self, model: mujoco.MjModel, spec: HandSpec, object_name: str) -> None:
        self._model = model
        self._palm, self._object = model.body("palm_link").id, model.body(object_name).id
        self._part = body_parts(model, spec)
        self.parts = part_names(spec)
        self._sites = [model.site(finger.tip).id for finger in spec.fingers]
        ends = [int(model.site_bodyid[site]) for site in self._sites]
        self._ways = [_way(model, end, self._part, k) for k, end in enumerate(ends)]
        self._hinges = [_hinge(model, way[-1]) for way in self._ways]
        self._closes = [_flexion(model, hinge) for hinge in self._hinges]
        last = {int(model.body_weldid[end]) for end in ends}
        self._last = np.array([int(weld) in last for weld in model.body_weldid])
        self._is_object = model.body_weldid[model.geom_bodyid] == self._object

    def __call__(self, data: mujoco.MjData) -> SurfaceForces:
        """What is exchanged in a state that a step has left."""
        model = self._model
        found = SurfaceForces(*(np.zeros((len(self.parts), len(SURFACES), *more)) for more in ((), (3,), (3,))))
        contact = data.contact
        ours = self._is_object[contact.geom] if data.ncon else np.zeros((0, 2), dtype=bool)
        turn, origin = data.xmat[self._palm].reshape(3, 3), data.xpos[self._palm]
        force = np.zeros(6)
        for index in np.flatnonzero(ours.any(axis=1) & (contact.efc_address >= 0)):
            first = bool(ours[index, 0])
            body = int(model.geom_bodyid[contact.geom[index, int(first)]])
            part = int(self._part[body])
            if part < 0:
                continue
            mujoco.mj_contactForce(model, data, int(index), force)
            normal = contact.frame[index, :3] * (-1.0 if first else 1.0)
            surface = self._surface(data, part, body, normal)
            found.force[part, surface] += force[0]
            found.normal[part, surface] += force[0] * (normal @ turn)
            found.point[part, surface] += force[0] * ((contact.pos[index] - origin) @ turn)
        return found

    def stance(self, data: mujoco.MjData | BodyPlaces) -> DigitPose:
        """How the digits stand."""
        rows = []
        turn = data.xmat[self._palm].reshape(3, 3)
        for site, way in zip(self._sites, self._ways, strict=True):
            points = np.array([*(data.xpos[body] for body in way), data.site_xpos[site]])
            length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
            reach = points[-1] - points[0]
            apart = max(float(np.linalg.norm(reach)), 1e-9)
            rows.append((reach @ turn / apart, length, apart / max(length, 1e-9)))
        direction, length_, straight = zip(*rows, strict=True) if rows else ([], [], [])
        return DigitPose(np.array(direction).reshape(-1, 3), np.array(length_), np.array(straight))

    def _surface(self, data: mujoco.MjData, part: int, body: int, normal: Array) -> int:
        if part == len(self._sites):
            return _PALM
        hinge = self._hinges[part]
        axis, anchor = data.xaxis[hinge], data.xanchor[hinge]
        if abs(float(normal @ axis)) > _SIDEWAYS:
            return _SIDE
        along = data.site_xpos[self._sites[part]] - anchor
        along = along / max(float(np.linalg.norm(along)), 1e-9)
        last = bool(self._last[body])
        if last and float(normal @ along) > _CAP:
            return _TIP
        # A digit that flexes about a moves each link's face ahead along a × r, r along that link.
        facing = along if last else self._along(data, part, body)
        if self._closes[part] * float(normal @ np.cross(axis, facing)) < 0.0:
            return _BACK
        return _PAD if last else _INNER

    def _along(self, data: mujoco.MjData, part: int, body: int) -> Array:
        """From the joint of a link before the last one to the next joint."""
        way, weld = self._ways[part], self._model.body_weldid
        place = next((k for k, each in enumerate(way) if weld[each] == weld[body]), 0)
        ahead = data.xpos[way[place + 1]] if place + 1 < len(way) else data.site_xpos[self._sites[part]]
        along: Array = ahead - data.xpos[way[place]]
        return along


def box_edges(model: mujoco.MjModel, object_name: str) -> Array:
    """Edges of the box around an object's shapes, in the object's own axes, (3,), m."""
    body = model.body(object_name).id
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for geom in np.flatnonzero(model.body_weldid[model.geom_bodyid] == body):
        entries = np.zeros(9)
        mujoco.mju_quat2Mat(entries, model.geom_quat[geom])
        box, turn = model.geom_aabb[geom], entries.reshape(3, 3)
        centre, half = model.geom_pos[geom] + turn @ box[:3], np.abs(turn) @ box[3:]
        low, high = np.minimum(low, centre - half), np.maximum(high, centre + half)
    found: Array = high - low
    return found


def _way(model: mujoco.MjModel, end: int, part: Indices, digit: int) -> list[int]:
    """The moving bodies of a digit, from its root to the one that carries its tip."""
    way = list[int]()
    body = end
    while body and part[body] == digit:
        if model.body_jntnum[body]:
            way.append(body)
        body = int(model.body_parentid[body])
    return way[::-1] or [end]


def _hinge(model: mujoco.MjModel, body: int) -> int:
    return int(model.body_jntadr[body]) if model.body_jntnum[body] else 0


def _flexion(model: mujoco.MjModel, hinge: int) -> float:
    """Which way a joint flexes: 1, -1, or 0 where its range does not say."""
    return float(np.sign(model.jnt_range[hinge].sum())) if model.jnt_limited[hinge] else 0.0
