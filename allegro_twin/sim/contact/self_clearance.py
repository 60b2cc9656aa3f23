"""Self-clearance: distances between the fingers and the palm of a hand in a posture."""

from __future__ import annotations

import threading
from collections.abc import Collection
from itertools import combinations, combinations_with_replacement

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.sim.model.joints import PostureMap
from allegro_twin.sim.model.parts import body_parts, part_names
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

SIGHT = 0.008
"""Parts further apart than this are not told from each other, m."""
Indices = NDArray[np.int_]


class SelfClearance:
    """Distances between the parts of a hand, from the shapes that collide in its simulation. `only`: of these pairs."""

    def __init__(self, spec: HandSpec, only: Collection[tuple[str, str]] = ()) -> None:
        model = compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
        self._model, self._data = model, mujoco.MjData(model)
        self._in_use = threading.Lock()
        self._posed = PostureMap(spec, model)
        names = part_names(spec)
        couples = list(combinations_with_replacement(range(len(names)), 2))
        if only:
            wanted = [{names.index(one), names.index(other)} for one, other in only]
            couples = [couple for couple in couples if set(couple) in wanted]
        self.pairs = tuple((names[a], names[b]) for a, b in couples)
        """Which two parts each column is about; a finger can also meet itself."""
        geoms = np.array(colliding_geoms(model), dtype=int).reshape(-1, 2)
        part = np.sort(body_parts(model, spec)[model.geom_bodyid[geoms]], axis=1).tolist()
        kept = [k for k, row in enumerate(part) if tuple(row) in couples]
        self._geoms = geoms[kept]
        self._columns = np.array([couples.index(tuple(part[k])) for k in kept], dtype=int)

    def __call__(self, postures: Array) -> Array:
        """The least distance of every pair of parts, postures (k, n), rad → (k, pairs), m: at most SIGHT; negative
        where they are that deep in each other."""
        model, data = self._model, self._data
        found = np.full((len(postures), len(self.pairs)), SIGHT)
        with self._in_use:
            rows, near = self._near(postures)
            for row in np.unique(rows):
                self._place(postures[row])
                for k in near[rows == row]:
                    apart = mujoco.mj_geomDistance(model, data, *self._geoms[k], SIGHT, None)
                    found[row, self._columns[k]] = min(found[row, self._columns[k]], apart)
        return found

    def _near(self, postures: Array) -> tuple[Indices, Indices]:
        """Which rows have which pairs of geoms that may be nearer than SIGHT: those of which no face of the one's
        bounding box has the other's that far in front of it."""
        model, data = self._model, self._data
        places, turns = np.empty((len(postures), model.ngeom, 3)), np.empty((len(postures), model.ngeom, 3, 3))
        for row, posture in enumerate(postures):
            self._place(posture)
            places[row], turns[row] = data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3)
        centre, half = model.geom_aabb[:, :3], model.geom_aabb[:, 3:]
        places += np.einsum("kgij,gj->kgi", turns, centre)
        a, b = self._geoms.T
        reach = np.linalg.norm(half, axis=1)
        away = places[:, b] - places[:, a]
        rows, pairs = np.nonzero(np.square(away).sum(axis=2) < (reach[a] + reach[b] + SIGHT) ** 2)
        away, a, b = away[rows, pairs], a[pairs], b[pairs]
        first, second = turns[rows, a], turns[rows, b]
        mixed = np.abs(np.einsum("kij,kil->kjl", first, second))
        front = np.abs(np.einsum("kij,ki->kj", first, away)) - half[a] - np.einsum("kjl,kl->kj", mixed, half[b])
        behind = np.abs(np.einsum("kij,ki->kj", second, away)) - half[b] - np.einsum("kjl,kj->kl", mixed, half[a])
        kept = np.maximum(front, behind).max(axis=1) < SIGHT
        return rows[kept], pairs[kept]

    def _place(self, posture: Array) -> None:
        self._posed(posture, self._data.qpos)
        mujoco.mj_kinematics(self._model, self._data)


def colliding_geoms(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """The geoms that the simulation lets touch: of two links that are not neighbours and not excluded by the MJCF. Of
    the neighbours of what stands still with the world, MuJoCo lets all touch it."""
    solid = [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
    excluded = {int(s) for s in model.exclude_signature}
    parent = model.body_weldid[model.body_parentid]

    def touch(a: int, b: int) -> bool:
        one, two = sorted(int(model.geom_bodyid[g]) for g in (a, b))
        weld, other = model.body_weldid[[one, two]]
        bits = model.geom_contype[a] & model.geom_conaffinity[b] or model.geom_contype[b] & model.geom_conaffinity[a]
        beside = parent[weld] == other or parent[other] == weld
        neighbours = weld == other or (beside and weld != 0 and other != 0)
        return bool(bits) and not neighbours and (one << 16) + two not in excluded

    return [(a, b) for a, b in combinations(solid, 2) if touch(a, b)]
