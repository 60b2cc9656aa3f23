"""Of the ways to take a thing, the one that the arm reaches best."""

from __future__ import annotations

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.pose import Pose
from allegro_twin.lab.cell import Room
from allegro_twin.lab.choice import Way, body_of, ways
from allegro_twin.perception.fits.model import Solid
from allegro_twin.types import Vector

_TRIED = 6
"""Ways, those first whose fingers point the most directly away from the arm."""


def best_way(solid: Solid, room: Room, near: Vector) -> Way:
    """The way whose approach and grasp the arm reaches with the least turn of a joint from a posture (n,), rad.

    Raises ConfigError where no stored grasp is for the thing, or the arm reaches none of the ways.
    """
    found = ways(body_of(solid), room.hand.spec.model)
    found.sort(key=lambda way: -_outward(way.palm, room.cell.base))
    reached: list[tuple[float, Way]] = []
    first: ConfigError | None = None
    for way in found[:_TRIED]:
        try:
            before = room.cell.model.reach(room.cell.flange_for(way.before), near)
            at = room.cell.model.reach(room.cell.flange_for(way.palm), before)
        except ConfigError as error:
            first = first or error
            continue
        reached.append((float(np.abs(np.stack([before, at]) - near).max()), way))
    if not reached:
        assert first is not None
        raise first
    return min(reached, key=lambda each: each[0])[1]


def _outward(palm: Pose, base: Pose) -> float:
    """The cosine between where stretched fingers point and the way from the arm's foot to the palm, both level."""
    away = (palm.position - base.position)[:2]
    return float(palm.rotation[:2, 2] @ away / np.linalg.norm(away))
