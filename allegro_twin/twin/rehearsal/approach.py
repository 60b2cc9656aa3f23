"""The approach of a rehearsal: from where a limp hand lies to where a motion begins, past its own fingers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from allegro_twin.app.rig import Rig, limp_while
from allegro_twin.control.trajectory import Waypoint
from allegro_twin.sim.contact.collision_free_paths import CollisionFreePaths
from allegro_twin.spec import HandSpec
from allegro_twin.types import HandState, Vector

TRACKING = 0.003
"""m that two parts of a hand come nearer than planned: 20 ms late at 1 rad/s, each, and 10 mrad beside."""


def plan_approach(spec: HandSpec, position: Vector, goal: Waypoint, shift: Vector, what: str) -> list[Waypoint]:
    """The waypoints to a posture, the goal last, on which no part of the hand comes nearer to another than it may
    with the errors of a hand that follows. `position`: where the encoders have the joints, (n,), rad; `shift`: to add
    to that for where they are, (n,), rad. Raises SelfCollision where no way is found."""
    limits, true = (spec.lower, spec.upper), replace(goal, posture=goal.posture + shift)
    legs = CollisionFreePaths(spec).legs(
        np.clip(position + shift, *limits), true, limits, what, margin=TRACKING, deepest=np.inf
    )
    via = [replace(leg, posture=np.clip(leg.posture - shift, *limits)) for leg in legs[:-1]]
    return [*via, replace(legs[-1], posture=goal.posture)]


def approach_from(
    rig: Rig, state: HandState, goal: Waypoint, shift: Vector, what: str
) -> tuple[HandState, list[Waypoint]]:
    """Plan the approach of a hand that has been reset. One whose time passes by itself stays limp meanwhile. Returns
    its newest state, and the waypoints from there. Raises as `plan_approach` and the hand do."""
    return limp_while(rig, state, lambda position: plan_approach(rig.spec, position, goal, shift, what))
