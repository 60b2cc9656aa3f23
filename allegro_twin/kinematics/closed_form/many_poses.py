"""Inverse kinematics of many targets: closed forms in blocks of rows, searches row by row."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import repeat
from math import nan

import numpy as np
from numpy.typing import NDArray

from allegro_twin.kinematics.closed_form.one_pose import BaseTarget, Chain
from allegro_twin.kinematics.closed_form.targets import IkTarget
from allegro_twin.kinematics.maths import ARRAYS
from allegro_twin.kinematics.orientation import Entries
from allegro_twin.kinematics.solutions import Flags, Nearest, Solutions
from allegro_twin.types import Array

_CHUNK = 4096  # Rows at a time: the intermediate arrays then stay in the processor's cache.
_BRANCHES = 4


def solve(chain: Chain, target: IkTarget[Array]) -> Solutions:
    """All branches of targets of the shape (...)."""
    n, k = len(target.angle), 1 if target.mode == "position" else _BRANCHES
    joints, within, angle = np.empty((4, k, n)), np.empty((k, n), dtype=bool), np.empty((k, n))
    for start in range(0, n, _CHUNK):
        rows = slice(start, start + _CHUNK)
        _solve_block(chain, _some(target, rows), joints[:, :, rows], within[:, rows], angle[:, rows])

    def search(missing: Flags, limited: bool) -> Nearest:
        return _nearest(chain, target, missing, limited=limited)

    return Solutions(
        np.moveaxis(joints, 0, -1).swapaxes(0, 1).reshape(*target.shape, k, 4),
        within.T.reshape(*target.shape, k),
        angle.T.reshape(*target.shape, k),
        chain.lower,
        chain.upper,
        search,
    )


def _solve_block(chain: Chain, target: IkTarget[Array], joints: Array, within: Flags, angle: Array) -> None:
    """Fills joints (4, k, n), within (k, n) and angle (k, n)."""
    base = chain.in_base(ARRAYS, target)
    found, left = chain.branches(ARRAYS, target, base)
    for branch, (q, off) in enumerate(zip(found, left, strict=True)):
        for joint, values in enumerate(q):
            joints[joint, branch] = values
        within[branch], angle[branch] = chain.within(q), off
    if target.mode == "position":
        _fill_preferred(chain, target, base, joints, within, angle)
    elif target.mode == "rotation":
        _turn_nearer(chain, base, joints, within, angle)
    if chain.sign < 0.0:
        np.negative(joints[0], out=joints[0])


def _fill_preferred(
    chain: Chain,
    target: IkTarget[Array],
    base: BaseTarget[Array],
    joints: Array,
    within: Flags,
    angle: Array,
) -> None:
    angle[...] = 0.0
    nears = repeat(None) if target.near is None else zip(*(column.tolist() for column in target.near), strict=True)
    for row, (one, near) in enumerate(zip(_rows(base), nears, strict=False)):
        q = chain.preferred(one, near)
        joints[:, 0, row], within[0, row] = (nan if q is None else q), q is not None


def _turn_nearer(chain: Chain, base: BaseTarget[Array], joints: Array, within: Flags, angle: Array) -> None:
    """Where no branch inside the limits is sure to be turned the nearest, the nearest replaces the first."""
    best = np.where(within, angle, np.inf).min(axis=0)
    rows = np.flatnonzero((best > chain.forms.surely_nearest) & (best < np.inf))
    left = [np.flatnonzero(np.isinf(best))]
    if rows.size:
        q, off, sure = chain.turned_nearer(ARRAYS, _picked(base, rows), best[rows])
        known = np.asarray(sure) & np.asarray(chain.within(q))
        better = known & (off < best[rows])
        for joint, values in enumerate(q):
            joints[joint, 0, rows[better]] = values[better]
        angle[0, rows[better]], within[0, rows[better]] = off[better], True
        left.append(rows[~known])
    rows = np.concatenate(left)
    for row, least, one in zip(rows.tolist(), best[rows].tolist(), _rows(_picked(base, rows)), strict=True):
        found = chain.nearest_orientation(one, least)
        if found is not None:
            joints[:, 0, row], angle[0, row], within[0, row] = *found, True


def _nearest(chain: Chain, target: IkTarget[Array], missing: Flags, *, limited: bool) -> Nearest:
    n, rows = len(target.angle), np.flatnonzero(missing)
    posture, point, distance = np.full((n, 4), nan), np.stack(target.position, axis=-1), np.zeros(n)
    base, angles = chain.in_base(ARRAYS, target), target.angle[rows].tolist()
    for row, value, one in zip(rows.tolist(), angles, _rows(_picked(base, rows)), strict=True):
        posture[row], point[row], distance[row] = chain.nearest(one, target.mode, value, limited=limited)
    shape = target.shape
    return Nearest(posture.reshape(*shape, 4), point.reshape(*shape, 3), distance.reshape(shape))


def _some(target: IkTarget[Array], rows: slice) -> IkTarget[Array]:
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


def _picked(base: BaseTarget[Array], rows: NDArray[np.intp]) -> BaseTarget[Array]:
    view = None if base.view is None else tuple(entry[rows] for entry in base.view)
    return BaseTarget(base.x[rows], base.y[rows], base.z[rows], view)


def _rows(base: BaseTarget[Array]) -> Iterator[BaseTarget[float]]:
    """One target after the other, on plain numbers."""
    points = zip(*(values.tolist() for values in base[:3]), strict=True)
    views = repeat(None) if base.view is None else zip(*(entry.tolist() for entry in base.view), strict=True)
    for (x, y, z), view in zip(points, views, strict=False):
        yield BaseTarget(x, y, z, view)
