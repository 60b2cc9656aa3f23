"""Things on a table and no hand: what a camera is tried with, here and in tests."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from allegro_twin.hands.description.appearance import TABLE
from allegro_twin.sim.objects.catalogue import GraspObject, PlacedObject, add_object, standing_orientation

_FRICTION = (0.8, 0.01, 0.001)  # Sliding, torsional (m), rolling (m): nothing moves in a picture.


def compile_tabletop(things: Sequence[PlacedObject], *, edge: float = 0.9) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A square table of an edge, m, whose top is at z = 0 around the origin, and the things on it, as they are put."""
    spec = mujoco.MjSpec()
    spec.stat.extent, spec.stat.center = 0.5, [0.0, 0.0, 0.0]
    spec.visual.map.znear = 0.02
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    world = spec.worldbody
    world.add_light(pos=[0.4, -0.6, 1.4], dir=[-0.3, 0.4, -1.0], diffuse=[0.55] * 3)
    world.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=[edge / 2, edge / 2, 0.02], pos=[0, 0, -0.02],
        rgba=[*TABLE, 1.0],
    )  # fmt: skip
    for thing in things:
        add_object(spec, thing, _FRICTION)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def place_standing(thing: GraspObject, up: str, yaw: float, x: float, y: float) -> PlacedObject:
    """It stands at a place (m) with its own axis `up` at the sky, turned by `yaw` (rad)."""
    w, i, j, k = (float(value) for value in standing_orientation(up, yaw))
    return PlacedObject(thing, (x, y, float(thing.half_extents()["xyz".index(up)])), (w, i, j, k))
