"""Collision-free paths of a hand in joint space: straight lines where they are clear, else RRT-Connect."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from allegro_twin.types import Array, Vector

PairDistances: TypeAlias = Callable[[Array], Array]
"""Postures (k, n), rad → the distance of every pair of parts, (k, pairs), m; negative: that deep in each other."""
CLEARANCE = 0.003
"""Distance kept on a path, m: several times the error of a hand that follows it. `sim.contact` keeps the same."""
_GRAIN = 0.01  # rad between two checks. They move a fingertip by 3 mm at most: all joints of a finger, levers of 0.1 m.
_COARSE = 8  # Every eighth of them is checked first: most lines that are not clear show it there.
_NOISE = 3e-4  # m. A smaller difference of distances does not count: the distance of two boxes is not smooth.
_BACK, _BACKS, _PROBE = (
    0.02,
    100,
    1e-3,
)  # rad of a step out of contact; steps; rad of a difference quotient.
_SOFT = 5e-4  # m. A pair that is so much further apart than the nearest one has a weight e times less.
_NEXT = 0.05  # rad. A goal nearer than that is reached without leaving a contact first.
_STOP = 0.3  # rad. Cost of a stop on the path: to stop and start again takes time.
_SEARCHES, _TRIES, _REACH = (
    4,
    400,
    0.3,
)  # Searches, of which the best counts; branches of each; their length, rad.


@dataclass(frozen=True, slots=True, eq=False)
class PlanningSpace:
    """The joint space of a hand with its distances."""

    apart: PairDistances
    fingers: Sequence[Sequence[int]]
    """The joints of each finger."""
    rest: Vector
    """Where a finger is likely to be out of the way of the others, (n,), rad."""
    lower: Vector
    upper: Vector
    """Joint limits, (n,), rad."""


def plan_path(space: PlanningSpace, start: Vector, goal: Vector) -> list[Vector] | None:
    """A collision-free path: postures to go through in straight lines, (n,) each, rad, the goal last; None if none is
    found.

    Out of contact by the shortest way, unless the goal is next to the start, for parts that lean on each other may be
    caught. From there in a straight line if it is clear, else through the space by what a search finds, and into
    contact, if the goal is in one. The same start and goal have the same way.
    """
    away = [start]
    leaning = space.apart(start[None]).min() < 0.0 and np.abs(goal - start).max() > _NEXT
    if leaning or not is_clear(space, start, goal):
        found = _back_out(space, start)
        if found is None:
            return None
        away = _shorten(space, found)
    if is_clear(space, away[-1], goal):
        return [*away[1:], goal]
    near = _back_out(space, goal)
    return None if near is None else _path_around(space, away, near[::-1])


def _path_around(space: PlanningSpace, away: list[Vector], near: list[Vector]) -> list[Vector] | None:
    """The cheapest of some paths from where the first rows end to where the last begin."""
    best, least = None, np.inf
    for seed in range(_SEARCHES):
        found = _search(space, away[-1], near[0], np.random.default_rng(seed))
        if found is None:
            break
        rows = _shorten(space, [*found, *near[1:]])
        cost = sum(float(np.abs(b - a).max()) + _STOP for a, b in pairwise(rows))
        if cost < least:
            best, least = [*away[1:], *rows[1:]], cost
    return best


def is_clear(space: PlanningSpace, start: Vector, goal: Vector, clearance: float = CLEARANCE) -> bool:
    """Whether the straight line keeps the clearance, (n,) each, rad. Where an end of it does not, the pair may only
    separate from there, or approach towards it."""
    rows = postures_on_line(start, goal)
    checks = [rows] if len(rows) < 2 * _COARSE else [np.vstack([rows[:-1:_COARSE], rows[-1]]), rows]
    return not any(crossing_pairs(space.apart(check), clearance).any() for check in checks)


def postures_on_line(start: Vector, goal: Vector) -> Array:
    """The postures at which a straight line is checked, both ends among them, (k, n), rad."""
    count = max(int(np.ceil(np.abs(goal - start).max() / _GRAIN)), 1)
    rows: Array = start + np.linspace(0.0, 1.0, count + 1)[:, None] * (goal - start)
    return rows


def crossing_pairs(apart: Array, clearance: float) -> NDArray[np.bool_]:
    """Which pairs come nearer than the clearance and separate again, (pairs,); distances on a path, (k, pairs), m."""
    distances = np.minimum(apart, clearance)
    before = np.maximum.accumulate(distances, axis=0)
    after = np.maximum.accumulate(distances[::-1], axis=0)[::-1]
    return np.asarray((distances < np.minimum(before, after) - _NOISE).any(axis=0))


def _back_out(space: PlanningSpace, posture: Vector) -> list[Vector] | None:
    """From a posture to the nearest that has the clearance, step by step up the gradient of the nearest distances."""
    rows, reach = [posture], CLEARANCE + 1e-3
    nudges = _PROBE * np.vstack([np.eye(len(posture)), -np.eye(len(posture))])
    for _ in range(_BACKS):
        distances, *probed = np.minimum(space.apart(np.vstack([rows[-1], rows[-1] + nudges])), reach)
        if distances.min() >= CLEARANCE:
            return rows
        ahead, behind = np.split(np.array(probed), 2)
        slope = (ahead - behind) @ np.where(distances < reach, np.exp((distances.min() - distances) / _SOFT), 0.0)
        if not slope.any():
            return None
        rows.append(np.clip(rows[-1] + _BACK * slope / np.abs(slope).max(), space.lower, space.upper))
    return None


class _Tree:
    """Postures that are reached from a root in clear straight lines."""

    def __init__(self, root: Vector) -> None:
        self.postures, self._before = [root], [-1]

    def grow(self, space: PlanningSpace, towards: Vector) -> tuple[int, bool]:
        """A branch from the nearest posture, `_REACH` long at most: its end, and whether it is clear, end included."""
        k = int(np.abs(np.array(self.postures) - towards).sum(axis=1).argmin())
        travel = towards - self.postures[k]
        further = np.abs(travel).max()
        end = towards if further <= _REACH else self.postures[k] + travel * (_REACH / further)
        if further == 0.0:
            return k, True
        if space.apart(end[None]).min() < CLEARANCE or not is_clear(space, self.postures[k], end):
            return k, False
        self.postures.append(end)
        self._before.append(k)
        return len(self.postures) - 1, True

    def path(self, k: int) -> list[Vector]:
        """From a posture back to the root."""
        rows = []
        while k >= 0:
            rows.append(self.postures[k])
            k = self._before[k]
        return rows


def _search(space: PlanningSpace, start: Vector, goal: Vector, random: np.random.Generator) -> list[Vector] | None:
    """The postures between two clear ones: RRT-Connect (Kuffner and LaValle, ICRA 2000). Each finger is sampled
    on its own, from everywhere or from one of three likely places."""
    places = np.stack([start, space.rest, goal])
    trees = (_Tree(start), _Tree(goal))
    for turn in range(_TRIES):
        mine, other = trees[turn % 2], trees[(turn + 1) % 2]
        sample = random.uniform(space.lower, space.upper)
        for joints, choice in zip(space.fingers, random.integers(5, size=len(space.fingers)), strict=True):
            if choice < len(places):
                sample[list(joints)] = places[choice, list(joints)]
        end, grown = mine.grow(space, sample)
        aim = mine.postures[end]
        while grown:
            met, grown = other.grow(space, aim)
            if np.array_equal(other.postures[met], aim):
                rows = [*mine.path(end)[::-1], *other.path(met)[1:]]
                return rows if turn % 2 == 0 else rows[::-1]
    return None


def _shorten(space: PlanningSpace, rows: list[Vector]) -> list[Vector]:
    """Remove the stops of a path that a straight clear line can bypass."""
    kept = [rows[0]]
    while len(rows) > 1:
        skip = next((k for k in range(len(rows) - 1, 1, -1) if is_clear(space, rows[0], rows[k])), 1)
        rows = rows[skip:]
        kept.append(rows[0])
    return kept
