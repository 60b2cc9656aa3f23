"""Parts of a hand: the finger, or the palm, that a body belongs to."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.spec import HandSpec

PALM = "palm"
Indices = NDArray[np.int_]


def part_names(spec: HandSpec) -> tuple[str, ...]:
    """The fingers in the spec's order, last the palm."""
    return (*(finger.name for finger in spec.fingers), PALM)


def body_parts(model: mujoco.MjModel, spec: HandSpec) -> Indices:
    """The number of each body's part in `part_names`, (bodies,): the finger on whose way from a moving joint to its tip
    it is, or off which it branches; else the palm; -1 for what is not the hand."""
    part = np.full(model.nbody, -1)
    palm = model.body("palm_link").id
    part[palm] = len(spec.fingers)
    ways = [_way(model, int(model.site(finger.tip).bodyid[0]), palm) for finger in spec.fingers]
    shared = {body for one, way in enumerate(ways) for other in ways[:one] for body in way if body in other}
    mine = {body: k for k, way in enumerate(ways) for body in way if body not in shared}
    for body in range(1, model.nbody):  # Parents come first.
        if part[body] < 0:
            part[body] = mine.get(body, part[model.body_parentid[body]])
    return part


def top_of_palm(model: mujoco.MjModel, spec: HandSpec) -> float:
    """The highest point, world, of what the palm's own bodies have for contacts, where the model begins, m."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    solid = (model.geom_contype | model.geom_conaffinity) != 0
    own = np.flatnonzero((body_parts(model, spec)[model.geom_bodyid] == len(spec.fingers)) & solid)
    box, up = model.geom_aabb[own], data.geom_xmat[own].reshape(-1, 3, 3)[:, 2]
    return float((data.geom_xpos[own, 2] + (up * box[:, :3]).sum(1) + (np.abs(up) * box[:, 3:]).sum(1)).max())


def _way(model: mujoco.MjModel, body: int, palm: int) -> list[int]:
    """From a tip's body back to the first that moves in the palm."""
    way: list[int] = []
    while body not in (palm, 0):
        way.append(body)
        body = int(model.body_parentid[body])
    while way and not model.body_jntnum[way[-1]]:
        way.pop()
    return way
