"""Inverse kinematics of one target, in plain numbers from beginning to end."""

from __future__ import annotations

from math import inf, nan

import numpy as np

from allegro_twin.kinematics.closed_form.bounds import Bounds
from allegro_twin.kinematics.closed_form.chain import Asked, Chain, Point
from allegro_twin.kinematics.closed_form.forms.maths import FLOATS
from allegro_twin.kinematics.closed_form.search.curve import Posture
from allegro_twin.kinematics.closed_form.search.nearest import Mode
from allegro_twin.kinematics.closed_form.target import Target
from allegro_twin.kinematics.solutions import Flags, Nearest, Solutions

_NONE: Posture = (nan, nan, nan, nan)


def solve(chain: Chain, bounds: Bounds, target: Target[float]) -> Solutions:
    """As of a batch of the shape ()."""
    asked, sign = chain.asked(FLOATS, target), chain.sign
    found, left = chain.branches(FLOATS, target, asked)
    within = [bool(bounds.within(q)) for q in found]
    if target.mode == "position":
        q = preferred(chain, bounds, asked, target.near)
        found, left, within = [q or _NONE], [0.0], [q is not None]
    elif target.mode == "rotation":
        best = min([angle for angle, ok in zip(left, within, strict=True) if ok], default=inf)
        better = _improved(chain, bounds, asked, best)
        if better is not None:
            found[0], left[0], within[0] = *better, True

    def search(missing: Flags, limits: bool) -> Nearest:
        if not missing:
            return Nearest(np.full(4, nan), np.array(target.position), np.zeros(()))
        posture, point, distance = nearest(chain, bounds, asked, target.mode, target.angle, limits=limits)
        return Nearest(np.array(posture), np.array(point), np.asarray(distance))

    rows = np.array([(sign * q0, q1, q2, q3) for q0, q1, q2, q3 in found])
    return Solutions(rows, np.array(within), np.array(left), bounds.lower, bounds.upper, search)


def _improved(chain: Chain, bounds: Bounds, asked: Asked[float], best: float) -> tuple[Posture, float] | None:
    """As `nearer`, if the best closed form is not sure to be it."""
    if best <= chain.forms.settled and best < inf:
        return None
    if best < inf:
        q, angle, sure = chain.nearer(FLOATS, asked, best)
        if sure and bounds.within(q):
            return (q, angle) if angle < best else None
    return nearer(chain, bounds, asked, best)


def preferred(chain: Chain, bounds: Bounds, asked: Asked[float], near: tuple[float, ...] | None) -> Posture | None:
    """The one posture of a position alone."""
    wish = None if near is None else (near[0] * chain.sign, *near[1:])
    return bounds.search.preferred(asked.x, asked.y, asked.z, wish)


def nearer(chain: Chain, bounds: Bounds, asked: Asked[float], best: float) -> tuple[Posture, float] | None:
    """A posture that is turned nearer than by an angle, rad, and by which; None if no other is."""
    assert asked.turn is not None
    q = bounds.search.turned(asked.x, asked.y, asked.z, asked.turn, best)
    if q is None:
        return None
    angle = chain.forms.angle_to(FLOATS, q, asked.turn)
    return (q, angle) if angle < best else None


def nearest(
    chain: Chain, bounds: Bounds, asked: Asked[float], mode: Mode, angle: float, *, limits: bool
) -> tuple[Posture, Point, float]:
    """The hand's posture that comes nearest, where its tip then is in the palm, and how far that is."""
    search = bounds.search if limits else bounds.anywhere
    distance, q = search.nearest(asked.x, asked.y, asked.z, mode, angle)
    if q is None:
        return _NONE, (nan, nan, nan), inf
    posture = q[0] * chain.sign, q[1], q[2], q[3]
    return posture, chain.fk(*posture), distance
