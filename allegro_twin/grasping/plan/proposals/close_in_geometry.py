"""Fingers that close until they meet something: each link stops where it touches, what is beyond it goes on."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from allegro_twin.grasping.metrics.contacts import Contacts, make_contacts
from allegro_twin.grasping.plan.candidate import Candidate
from allegro_twin.sim.contact.grasp_scene import GraspScene, Indices, TouchPoints
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector, frozen

COARSE, FINE = 0.17, 0.04
"""rad, of a step: where physics closes the fingers again afterwards, and where nothing does."""
EXACT = 0.02
"""rad: the step of the last stretch, where forces are reckoned from where the fingers are."""
FURTHEST = 1.6
"""rad that a joint closes."""


@lru_cache(maxsize=8)
def motor_scale(spec: HandSpec) -> Vector:
    """How far each motor goes while what it moves turns by a radian, (n,): 1 where it turns joints itself; less where a
    tendon or a linkage moves its fastest follower by more, and where its whole way is short, on a slide say."""
    found = np.ones(spec.n_joints)
    span = spec.upper - spec.lower
    for each in spec.followers:
        steepest = np.abs(np.diff(each.positions)).max() * (len(each.positions) - 1) / span[each.driven]
        found[each.driven] = min(found[each.driven], 1.0 / max(steepest, 1e-9), span[each.driven] / FURTHEST)
    return frozen(found)


def close_fingers(bench: GraspScene, candidate: Candidate, step: float = COARSE) -> tuple[Candidate, TouchPoints]:
    """The candidate with its fingers closed, each motor where the last joint that it moves has stopped, and where the
    hand touches the object."""
    spec, of = bench.spec, bench.motors
    by, lower, upper = motor_scale(spec)[of], spec.lower[of], spec.upper[of]
    at, moving = candidate.preshape[of].copy(), candidate.closing[of].copy()
    furthest = np.where(np.isin(of, [each.driven for each in spec.followers]), (upper - lower) / by, FURTHEST)
    stride = step * by
    bench.carry(candidate.position, candidate.rotation)
    for _ in range(round(float(furthest.max()) / step)):
        at = np.minimum(np.maximum(at + stride * moving, lower), upper)
        bench.bend_each(at)
        moving[bench.stopped() | (at <= lower) | (at >= upper)] = 0.0
        if not moving.any():
            break
    return replace(candidate, close=_last(candidate, of, at)), bench.touch()


def meet_exactly(bench: GraspScene, candidate: Candidate) -> tuple[Candidate, TouchPoints]:
    """Close the fingers within `EXACT`: coarse steps to where something is met, and fine ones over the last of them
    again."""
    coarse, touch = close_fingers(bench, candidate, COARSE)
    if len(set(touch.part.tolist())) < 2:
        return coarse, touch  # A finger alone holds nothing, however exactly it touches.
    travel = candidate.closing * (coarse.close - candidate.preshape)
    short = candidate.preshape + candidate.closing * np.maximum(travel - 1.2 * COARSE, 0.0)
    fine, touch = close_fingers(bench, replace(candidate, preshape=short), EXACT)
    return replace(fine, preshape=candidate.preshape), touch


def _last(candidate: Candidate, of: Indices, at: Vector) -> Vector:
    """Where the motors are whose joints are `at`, (joints,): with that joint which has gone furthest."""
    close = candidate.preshape.copy()
    if len(set(of.tolist())) == len(of):
        close[of] = at
        return close
    for motor in np.unique(of):
        mine = at[of == motor]
        close[motor] = mine[np.argmax(candidate.closing[motor] * mine)]
    return close


LEVER = 0.04
"""m: what makes a moment a force, about the radius of what a hand holds."""
UNBALANCED = 0.25
"""More of every newton than this is left over: the fingers would push the object away."""


def metric_contacts(touch: TouchPoints, centre: Array, friction: float, torsion: float = 0.0) -> Contacts:
    """What a workbench has found, as contacts of which metrics are taken; `torsion`: of each, m."""
    return make_contacts(touch.points, touch.normals, friction, torsion, centre=centre, length=LEVER)


def torsion_radius(bench: GraspScene) -> float:
    """Counted for a hand of two fingers alone, m: about the line between them nothing else resists."""
    return float(bench.model.geom_friction[:, 1].max()) if len(bench.spec.fingers) == 2 else 0.0
