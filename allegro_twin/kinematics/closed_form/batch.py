"""Inverse kinematics of many targets: the closed forms in blocks of rows, and what has no closed form row by row."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import repeat
from math import nan

import numpy as np
from numpy.typing import NDArray

from allegro_twin.kinematics.closed_form.bounds import Bounds
from allegro_twin.kinematics.closed_form.chain import Asked, Chain
from allegro_twin.kinematics.closed_form.forms.maths import ARRAYS
from allegro_twin.kinematics.closed_form.single import nearer, nearest, preferred
from allegro_twin.kinematics.closed_form.target import Target
from allegro_twin.kinematics.orientation import Entries
from allegro_twin.kinematics.solutions import Flags, Nearest, Solutions
from allegro_twin.types import Array

_CHUNK = 4096  # Rows at a time: the intermediate arrays then stay in the processor's cache.
_BRANCHES = 4


def solve(chain: Chain, bounds: Bounds, target: Target[Array]) -> Solutions:
    """All branches of targets of the shape (...)."""
    n, k = len(target.angle), 1 if target.mode == "position" else _BRANCHES
    joints, within, angle = np.empty((4, k, n)), np.empty((k, n), dtype=bool), np.empty((k, n))
    for start in range(0, n, _CHUNK):
        rows = slice(start, start + _CHUNK)
        _solve(chain, bounds, _some(target, rows), joints[:, :, rows], within[:, rows], angle[:, rows])

    def search(missing: Flags, limits: bool) -> Nearest:
        return _nearest(chain, bounds, target, missing, limits=limits)

    return Solutions(
        np.moveaxis(joints, 0, -1).swapaxes(0, 1).reshape(*target.shape, k, 4),
        within.T.reshape(*target.shape, k),
        angle.T.reshape(*target.shape, k),
        bounds.lower,
        bounds.upper,
        search,
    )


def _solve(chain: Chain, bounds: Bounds, target: Target[Array], joints: Array, within: Flags, angle: Array) -> None:
    """Fills joints (4, k, n), within (k, n) and angle (k, n)."""
    asked = chain.asked(ARRAYS, target)
    found, left = chain.branches(ARRAYS, target, asked)
    for branch, (q, off) in enumerate(zip(found, left, strict=True)):
        for joint, values in enumerate(q):
            joints[joint, branch] = values
        within[branch], angle[branch] = bounds.within(q), off
    if target.mode == "position":
        _preferred(chain, bounds, target, asked, joints, within, angle)
    elif target.mode == "rotation":
        _improved(chain, bounds, asked, joints, within, angle)
    if chain.sign < 0.0:
        np.negative(joints[0], out=joints[0])


def _preferred(
    chain: Chain, bounds: Bounds, target: Target[Array], asked: Asked[Array], joints: Array, within: Flags, angle: Array
) -> None:
    angle[...] = 0.0
    wishes = repeat(None) if target.near is None else zip(*(column.tolist() for column in target.near), strict=True)
    for row, (one, wish) in enumerate(zip(_rows(asked), wishes, strict=False)):
        q = preferred(chain, bounds, one, wish)
        joints[:, 0, row], within[0, row] = (nan if q is None else q), q is not None


def _improved(chain: Chain, bounds: Bounds, asked: Asked[Array], joints: Array, within: Flags, angle: Array) -> None:
    """Where no branch inside the limits is sure to be turned the nearest, the first becomes what is."""
    best = np.where(within, angle, np.inf).min(axis=0)
    rows = np.flatnonzero((best > chain.forms.settled) & (best < np.inf))
    left = [np.flatnonzero(np.isinf(best))]
    if rows.size:
        q, off, sure = chain.nearer(ARRAYS, _picked(asked, rows), best[rows])
        known = np.asarray(sure) & np.asarray(bounds.within(q))
        better = known & (off < best[rows])
        for joint, values in enumerate(q):
            joints[joint, 0, rows[better]] = values[better]
        angle[0, rows[better]], within[0, rows[better]] = off[better], True
        left.append(rows[~known])
    rows = np.concatenate(left)
    for row, least, one in zip(rows.tolist(), best[rows].tolist(), _rows(_picked(asked, rows)), strict=True):
        found = nearer(chain, bounds, one, least)
        if found is not None:
            joints[:, 0, row], angle[0, row], within[0, row] = *found, True


def _nearest(chain: Chain, bounds: Bounds, target: Target[Array], missing: Flags, *, limits: bool) -> Nearest:
    n, rows = len(target.angle), np.flatnonzero(missing)
    posture, point, distance = np.full((n, 4), nan), np.stack(target.position, axis=-1), np.zeros(n)
    asked, angles = chain.asked(ARRAYS, target), target.angle[rows].tolist()
    for row, value, one in zip(rows.tolist(), angles, _rows(_picked(asked, rows)), strict=True):
        posture[row], point[row], distance[row] = nearest(chain, bounds, one, target.mode, value, limits=limits)
    shape = target.shape
    return Nearest(posture.reshape(*shape, 4), point.reshape(*shape, 3), distance.reshape(shape))


def _some(target: Target[Array], rows: slice) -> Target[Array]:
    x, y, z = target.position
    return target._replace(
        position=(x[rows], y[rows], z[rows]),
        angle=target.angle[rows],
        rotation=None if target.rotation is None else _entries(target.rotation, rows),
        near=None if target.near is None else tuple(joint[rows] for joint in target.near),
    )


def _entries(rotation: Entries[Array], rows: slice) -> Entries[Array]:
    a, b, c, d, e, f, g, h, i = (entry[rows] for entry in rotation)
    return a, b, c, d, e, f, g, h, i


def _picked(asked: Asked[Array], rows: NDArray[np.intp]) -> Asked[Array]:
    turn = None if asked.turn is None else tuple(entry[rows] for entry in asked.turn)
    return Asked(asked.x[rows], asked.y[rows], asked.z[rows], turn)


def _rows(asked: Asked[Array]) -> Iterator[Asked[float]]:
    """One after the other, in plain numbers."""
    points = zip(*(values.tolist() for values in asked[:3]), strict=True)
    turns = repeat(None) if asked.turn is None else zip(*(entry.tolist() for entry in asked.turn), strict=True)
    for (x, y, z), turn in zip(points, turns, strict=False):
        yield Asked(x, y, z, turn)
