"""Bodies of a scene that stand in each other where a simulation begins: physics would throw them apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco

from allegro_twin.errors import ConfigError
from allegro_twin.types import Vector

TOLERANCE = 1e-3
"""m: what stands in something by less is pushed out of it and hardly moves."""


class InitialOverlap(NamedTuple):
    """Two parts of a scene that stand in each other."""

    names: frozenset[str]
    """Objects, links, and of what stands still the geoms, by their names in the scene."""
    depth: float
    """m."""


def initial_overlaps(
    model: mujoco.MjModel, objects: Sequence[str], position: Vector | None = None
) -> list[InitialOverlap]:
    """Overlaps of more than `TOLERANCE`, the deepest first. `objects`: bodies that are named as a whole, whichever of
    their parts it is. `position`: the scene's generalised position, (nq,); None: as it is compiled."""
    data = mujoco.MjData(model)
    if position is not None:
        data.qpos[:] = position
    mujoco.mj_fwdPosition(model, data)
    deepest: dict[frozenset[str], float] = {}
    for geoms, distance in zip(data.contact.geom, data.contact.dist, strict=True):
        names = frozenset(_name(model, int(geom), objects) for geom in geoms)
        if -distance > max(TOLERANCE, deepest.get(names, 0.0)) and len(names) == 2:
            deepest[names] = -float(distance)
    found = [InitialOverlap(names, depth) for names, depth in deepest.items()]
    return sorted(found, key=lambda each: -each.depth)


def check_objects_apart(model: mujoco.MjModel, objects: Sequence[str], position: Vector | None = None) -> None:
    """Raise ConfigError for two objects that stand in each other. Arguments as of `initial_overlaps`."""
    for names, depth in initial_overlaps(model, objects, position):
        if names <= set(objects):
            one, other = (name for name in objects if name in names)
            raise ConfigError(
                f"objects {one} and {other} stand {1e3 * depth:.0f} mm in each other where the scene begins: move one "
                "of them by its `at`"
            )


def _name(model: mujoco.MjModel, geom: int, objects: Sequence[str]) -> str:
    body = int(model.geom_bodyid[geom])
    root = model.body(int(model.body_rootid[body])).name
    if root in objects:
        return str(root)
    return str(model.geom(geom).name if body == 0 else model.body(body).name)
