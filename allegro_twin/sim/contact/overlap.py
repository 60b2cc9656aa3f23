"""Does an object fit into a hand: how deep the two are in each other before anything moves."""

from __future__ import annotations

import copy

import mujoco

from allegro_twin.sim.model.postures import Posed
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector


def overlap(model: mujoco.MjModel, spec: HandSpec, posture: Vector, thing: str, pose: Vector, scale: float) -> float:
    """The deepest contact between a free body and the hand, m; 0 where they are apart.

    The fingers are at `posture` (n,), rad, the body at `pose` (7,), m, and `scale` times its size.
    """
    model = copy.copy(model)
    body = model.body(thing)
    first, count = int(body.geomadr[0]), int(body.geomnum[0])
    model.geom_size[first : first + count] *= scale
    model.geom_rbound[first : first + count] *= scale
    model.geom_aabb[first : first + count] *= scale
    boxes = slice(int(model.body_bvhadr[body.id]), int(model.body_bvhadr[body.id] + model.body_bvhnum[body.id]))
    model.bvh_aabb[boxes] *= scale
    data = mujoco.MjData(model)
    Posed(spec, model)(posture, data.qpos)
    data.joint(thing).qpos[:] = pose
    mujoco.mj_forward(model, data)
    deepest = 0.0
    for contact in data.contact:
        bodies = [int(model.geom_bodyid[geom]) for geom in contact.geom]
        if body.id in bodies and 0 not in bodies:
            deepest = max(deepest, -float(contact.dist))
    return deepest
