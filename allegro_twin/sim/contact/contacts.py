"""Contacts of a hand and an object in a MuJoCo scene, as arrays that need no MuJoCo."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from allegro_twin.sim.model.contact_forces import contact_forces
from allegro_twin.sim.model.joints import PostureMap
from allegro_twin.sim.model.parts import Indices, body_parts
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector


@dataclass(frozen=True, slots=True, eq=False)
class SceneContacts:
    """The contacts between a hand and an object at one moment, in the world."""

    points: Array
    """(k, 3), m."""
    normals: Array
    """(k, 3), unit, into the object."""
    tangents: Array
    """(k, 3), unit, across the normals: MuJoCo's own."""
    force: Array
    """Contact force of the hand on the object, friction included, world frame, (k, 3), N; zero where the contact is not
    in the solver."""
    depth: Vector
    """Penetration, (k,), m; below 0 where the bodies are near each other."""
    friction: Vector
    """Sliding, (k,)."""
    torsion: Vector
    """Torsional, (k,), m; 0 where MuJoCo takes the contact as hard."""
    part: Indices
    """Index in `parts.part_names`, a finger or the palm, (k,)."""
    bodies: Indices
    """The hand's body at each contact, (k,)."""
    centre: Vector
    """The object's centre of mass, (3,), m."""
    length: float
    """The farthest that the object's surface can be from there, m: by the bounding spheres of its geoms."""


def find_contacts(
    model: mujoco.MjModel, data: mujoco.MjData, spec: HandSpec, object_name: str, near: float = 0.0
) -> SceneContacts:
    """The contacts of an object, after `mj_forward` or a step. `near`, m: also those that do not touch yet by as much,
    which MuJoCo only finds within margin + gap."""
    body, part = model.body(object_name).id, body_parts(model, spec)
    contact = data.contact
    bodies = model.geom_bodyid[contact.geom] if data.ncon else np.zeros((0, 2), dtype=np.int_)
    mine = model.body_weldid[bodies] == body
    other = np.where(mine[:, 0], bodies[:, 1], bodies[:, 0])
    chosen = np.flatnonzero(mine.any(axis=1) & (part[other] >= 0) & (contact.dist <= near))
    sign = np.where(mine[chosen, 0], -1.0, 1.0)[:, None]  # MuJoCo's normal points from the first geom to the second.
    frame = contact.frame[chosen].reshape(-1, 3, 3)
    local = contact_forces(model, data, chosen)
    return SceneContacts(
        contact.pos[chosen].copy(),
        sign * frame[:, 0],
        frame[:, 1].copy(),
        sign * np.einsum("ki,kij->kj", local, frame),
        -contact.dist[chosen],
        contact.friction[chosen, 0].copy(),
        np.where(contact.dim[chosen] >= 4, contact.friction[chosen, 2], 0.0),
        part[other[chosen]],
        other[chosen],
        data.subtree_com[body].copy(),
        _radius(model, data, body),
    )


STILL = "world"
"""MuJoCo's name of what does not move."""


class Obstruction(NamedTuple):
    """Body in contact with a hand, or with an arm that carries it."""

    depth: float
    """m."""
    body: str
    """Name of the body of hand or arm."""
    other: str
    """`STILL`: a table, or what else does not move."""

    def __str__(self) -> str:
        where = "the table" if self.other == STILL else self.other
        return f"{self.body} would be {1e3 * self.depth:.1f} mm inside {where}"


def obstructions(model: mujoco.MjModel, data: mujoco.MjData, spec: HandSpec, object_name: str) -> list[Obstruction]:
    """Everything that hand and arm are in, the deepest first, after `mj_forward` or a step: what stands still, the
    object, and one the other. The hand's links among themselves are not looked at: those are its posture's."""
    part, weld = body_parts(model, spec), model.body_weldid
    moves = (weld != 0) & (weld != model.body(object_name).id)
    found = []
    for contact in data.contact:
        # What moves with the arm first.
        one, other = sorted((int(model.geom_bodyid[geom]) for geom in contact.geom), key=lambda body: not moves[body])
        if contact.dist < 0.0 and moves[one] and min(part[one], part[other]) < 0:
            found.append(
                Obstruction(
                    -float(contact.dist), model.body(one).name, STILL if weld[other] == 0 else model.body(other).name
                )
            )
    return sorted(found, reverse=True)


def contact_jacobians(model: mujoco.MjModel, data: mujoco.MjData, spec: HandSpec, touch: SceneContacts) -> Array:
    """Jacobians of the hand at each contact, (k, 6, n): velocity, m/s, and angular velocity, rad/s, in the world per
    q̇."""
    columns = [int(model.joint(name).dofadr[0]) for name in spec.joints]
    found = np.zeros((len(touch.points), 6, len(columns)))
    speed, spin = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for index, (point, body) in enumerate(zip(touch.points, touch.bodies, strict=True)):
        mujoco.mj_jac(model, data, speed, spin, point, int(body))
        found[index] = np.vstack([speed[:, columns], spin[:, columns]])
    return found


def _radius(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> float:
    geoms = np.flatnonzero(
        (model.body_weldid[model.geom_bodyid] == body) & (model.geom_contype | model.geom_conaffinity)
    )
    reach = np.linalg.norm(data.geom_xpos[geoms] - data.subtree_com[body], axis=1) + model.geom_rbound[geoms]
    return float(reach.max(initial=0.0))


def penetration_depth(
    model: mujoco.MjModel, spec: HandSpec, posture: Vector, object_name: str, pose: Vector, scale: float
) -> float:
    """The deepest contact between a free body and the hand, m; 0 where they are apart.

    The fingers are at `posture` (n,), rad, the body at `pose` (7,), m, and `scale` times its size.
    """
    model = copy.copy(model)
    body = model.body(object_name)
    first, count = int(body.geomadr[0]), int(body.geomnum[0])
    model.geom_size[first : first + count] *= scale
    model.geom_rbound[first : first + count] *= scale
    model.geom_aabb[first : first + count] *= scale
    boxes = slice(int(model.body_bvhadr[body.id]), int(model.body_bvhadr[body.id] + model.body_bvhnum[body.id]))
    model.bvh_aabb[boxes] *= scale
    data = mujoco.MjData(model)
    PostureMap(spec, model)(posture, data.qpos)
    data.joint(object_name).qpos[:] = pose
    mujoco.mj_forward(model, data)
    deepest = 0.0
    for contact in data.contact:
        bodies = [int(model.geom_bodyid[geom]) for geom in contact.geom]
        if body.id in bodies and 0 not in bodies:
            deepest = max(deepest, -float(contact.dist))
    return deepest
