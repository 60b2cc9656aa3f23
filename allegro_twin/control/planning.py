"""A way from posture to posture on which the parts of a hand keep clear of each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from allegro_twin.types import Array, Vector

Apart: TypeAlias = Callable[[Array], Array]
"""Postures (k, n), rad → the distance of every pair of parts, (k, pairs), m; negative: that deep in each other."""
CLEARANCE = 0.003
"""Kept on the way, m: several times what a hand that follows a path leaves it by. `sim.solve` keeps the same."""
_GRAIN = 0.01  # rad between two looks. The fingertip is moved by 3 mm at most: all joints of a finger, levers of 0.1 m.
_COARSE = 8  # Every so many of them come first: most lines that are not clear show it there.
_NOISE = 3e-4  # m. What is nearer by less is not nearer: the distance of two boxes is not smooth.
_BACK, _BACKS, _PROBE = 0.02, 100, 1e-3  # rad a step away from a contact; how many; rad for a difference quotient.
_SOFT = 5e-4  # m. How much further apart than the nearest pair another one is before it counts e times less.
_NEXT = 0.05  # rad. A goal nearer than that is reached without leaving a contact first.
_STOP = 0.3  # rad. What one more stop on the way is worth: to stop and start again takes time.
_SEARCHES, _TRIES, _REACH = 4, 400, 0.3  # Searches, of which the best counts; branches that one tries, rad long.


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """What there is to know of a hand to find a way in it."""

    apart: Apart
    fingers: Sequence[Sequence[int]]
    """The joints of each finger."""
    rest: Vector
    """Where a finger is likely to be out of the way of the others, (n,), rad."""
    lower: Vector
    upper: Vector
    """Joint limits, (n,), rad."""


def way(room: Room, start: Vector, goal: Vector) -> list[Vector] | None:
    """The postures to go through in straight lines, (n,) each, rad, the goal last; None where none was found.

    Out of contact by the shortest way, unless the goal is next to the start, for parts that lean on each other may be
    caught. From there in a straight line if it is clear, else through the room by what a search finds, and into
    contact, if the goal is in one. The same start and goal have the same way.
    """
    away = [start]
    leaning = room.apart(start[None]).min() < 0.0 and np.abs(goal - start).max() > _NEXT
    if leaning or not clear(room, start, goal):
        found = _backed_out(room, start)
        if found is None:
            return None
        away = _shortened(room, found)
    if clear(room, away[-1], goal):
        return [*away[1:], goal]
    near = _backed_out(room, goal)
    return None if near is None else _round(room, away, near[::-1])


def _round(room: Room, away: list[Vector], near: list[Vector]) -> list[Vector] | None:
    """The cheapest of some ways that lead on from where the first rows end to where the last begin."""
    best, least = None, np.inf
    for seed in range(_SEARCHES):
        found = _searched(room, away[-1], near[0], np.random.default_rng(seed))
        if found is None:
            break
        rows = _shortened(room, [*found, *near[1:]])
        cost = sum(float(np.abs(b - a).max()) + _STOP for a, b in pairwise(rows))
        if cost < least:
            best, least = [*away[1:], *rows[1:]], cost
    return best


def clear(room: Room, start: Vector, goal: Vector, clearance: float = CLEARANCE) -> bool:
    """Whether the straight line keeps the clearance, (n,) each, rad. Where an end of it does not, the pair may only
    come apart from there, or together towards it."""
    rows = on_line(start, goal)
    looks = [rows] if len(rows) < 2 * _COARSE else [np.vstack([rows[:-1:_COARSE], rows[-1]]), rows]
    return not any(crossing(room.apart(look), clearance).any() for look in looks)


def on_line(start: Vector, goal: Vector) -> Array:
    """The postures at which a straight line is looked at, both ends among them, (k, n), rad."""
    count = max(int(np.ceil(np.abs(goal - start).max() / _GRAIN)), 1)
    rows: Array = start + np.linspace(0.0, 1.0, count + 1)[:, None] * (goal - start)
    return rows


def crossing(apart: Array, clearance: float) -> NDArray[np.bool_]:
    """Which pairs come nearer than the clearance and apart again, (pairs,), distances along a path (k, pairs), m."""
    seen = np.minimum(apart, clearance)
    before = np.maximum.accumulate(seen, axis=0)
    after = np.maximum.accumulate(seen[::-1], axis=0)[::-1]
    return np.asarray((seen < np.minimum(before, after) - _NOISE).any(axis=0))


def _backed_out(room: Room, posture: Vector) -> list[Vector] | None:
    """From a posture to the nearest that has the clearance, step by step up the gradient of the nearest distances."""
    rows, reach = [posture], CLEARANCE + 1e-3
    nudges = _PROBE * np.vstack([np.eye(len(posture)), -np.eye(len(posture))])
    for _ in range(_BACKS):
        seen, *probed = np.minimum(room.apart(np.vstack([rows[-1], rows[-1] + nudges])), reach)
        if seen.min() >= CLEARANCE:
            return rows
        ahead, behind = np.split(np.array(probed), 2)
        slope = (ahead - behind) @ np.where(seen < reach, np.exp((seen.min() - seen) / _SOFT), 0.0)
        if not slope.any():
            return None
        rows.append(np.clip(rows[-1] + _BACK * slope / np.abs(slope).max(), room.lower, room.upper))
    return None


class _Tree:
    """Postures that can be reached from a root in clear straight lines."""

    def __init__(self, root: Vector) -> None:
        self.postures, self._before = [root], [-1]

    def grow(self, room: Room, towards: Vector) -> tuple[int, bool]:
        """A branch from the nearest posture, `_REACH` long at most: its end, and whether it is clear, end included."""
        k = int(np.abs(np.array(self.postures) - towards).sum(axis=1).argmin())
        travel = towards - self.postures[k]
        further = np.abs(travel).max()
        end = towards if further <= _REACH else self.postures[k] + travel * (_REACH / further)
        if further == 0.0:
            return k, True
        if room.apart(end[None]).min() < CLEARANCE or not clear(room, self.postures[k], end):
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


def _searched(room: Room, start: Vector, goal: Vector, random: np.random.Generator) -> list[Vector] | None:
    """The postures between two clear ones: RRT-Connect (Kuffner and LaValle, ICRA 2000). Each finger is drawn on its
    own, from everywhere or one of the three places where it is most likely to be of use."""
    places = np.stack([start, room.rest, goal])
    trees = (_Tree(start), _Tree(goal))
    for turn in range(_TRIES):
        mine, other = trees[turn % 2], trees[(turn + 1) % 2]
        drawn = random.uniform(room.lower, room.upper)
        for joints, choice in zip(room.fingers, random.integers(5, size=len(room.fingers)), strict=True):
            if choice < len(places):
                drawn[list(joints)] = places[choice, list(joints)]
        end, grown = mine.grow(room, drawn)
        aim = mine.postures[end]
        while grown:
            met, grown = other.grow(room, aim)
            if np.array_equal(other.postures[met], aim):
                rows = [*mine.path(end)[::-1], *other.path(met)[1:]]
                return rows if turn % 2 == 0 else rows[::-1]
    return None


def _shortened(room: Room, rows: list[Vector]) -> list[Vector]:
    """The same way without the stops that can be left out."""
    kept = [rows[0]]
    while len(rows) > 1:
        skip = next((k for k in range(len(rows) - 1, 1, -1) if clear(room, rows[0], rows[k])), 1)
        rows = rows[skip:]
        kept.append(rows[0])
    return kept
