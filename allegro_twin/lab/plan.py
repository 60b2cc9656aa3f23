"""Of the ways to take a thing, the one that the arm reaches best."""

from __future__ import annotations

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.pose import Pose
from allegro_twin.lab.cell import Room
from allegro_twin.lab.choice import Way, body_of, ways
from allegro_twin.perception.fits.model import Solid
from allegro_twin.perception.verdict import place

_TRIED = 8
"""Ways, those first in which the arm bends the least."""
_NEAR = 2e-3
"""m and rad: how exactly it has to reach them on paper; the spring goes on from there."""
_ROOM = 0.08
"""rad: to the end of every joint."""


def best_way(solid: Solid, room: Room) -> Way:
    """The way whose approach and grasp the arm reaches with the least turn of a joint from where it waits.

    Raises ConfigError where no stored grasp is for the thing, or the arm reaches none of the ways.
    """
    found = ways(body_of(solid), room.hand.spec.model)
    found.sort(key=lambda way: -_across(way.palm, room.cell.base))
    reached = [(turned, way) for way in found[:_TRIED] if (turned := _turned(way, room)) is not None]
    if not reached:
        best = found[0]
        raise ConfigError(
            f"{room.cell.spec.name} does not reach the {best.card.name} grasp of the {solid.shape} at "
            f"{place(solid.position)} with room in its joints: move the thing nearer, or turn it by 90 degrees"
        )
    return min(reached, key=lambda each: each[0])[1]


def _turned(way: Way, room: Room) -> float | None:
    """The largest turn of a joint, rad; None where the arm does not get there."""
    model, spec, at = room.cell.model, room.cell.spec, room.posture
    postures = []
    for palm in (way.before, way.palm):
        try:
            at = model.reach(room.cell.flange_for(palm), at, _NEAR)
        except ConfigError:
            return None  # The answer, not an error.
        postures.append(at)
    if min(float(np.minimum(q - spec.lower, spec.upper - q).min()) for q in postures) < _ROOM:
        return None
    return float(np.abs(np.stack(postures) - room.posture).max())


def _across(palm: Pose, base: Pose) -> float:
    """How well stretched fingers point to the right of the way from the arm's foot to the palm, -1 to 1: there the
    elbow is up and no joint near its end, whichever way the palm looks."""
    away = (palm.position - base.position)[:2]
    return float(palm.rotation[:2, 2] @ np.array([away[1], -away[0]]) / np.linalg.norm(away))
