"""How far apart the parts of a hand are in a posture: its fingers, and its palm."""

from __future__ import annotations

import threading
from itertools import combinations_with_replacement

import mujoco
import numpy as np

from allegro_twin.sim.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

SIGHT = 0.008
"""Parts further apart than this are not told from each other, m."""
PALM = "palm"


class Clearance:
    """Distances between the parts of a hand, from the shapes that collide in its simulation."""

    def __init__(self, spec: HandSpec) -> None:
        model = compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
        # Two geoms are a contact from the sum of their margins on; its distance is theirs (docs/models.md#contact).
        model.geom_margin[:], model.geom_gap[:] = SIGHT / 2, 0.0
        self._model, self._data = model, mujoco.MjData(model)
        self._in_use = threading.Lock()
        self._places = [int(model.joint(name).qposadr[0]) for name in spec.joints]
        names = (*(finger.name for finger in spec.fingers), PALM)
        couples = list(combinations_with_replacement(range(len(names)), 2))
        self.pairs = tuple((names[a], names[b]) for a, b in couples)
        """Which two parts each column is about; a finger can also meet itself."""
        self._column = np.zeros((len(names), len(names)), dtype=int)
        for column, (a, b) in enumerate(couples):
            self._column[a, b] = self._column[b, a] = column
        self._part = _parts(model, spec)[model.geom_bodyid]

    def __call__(self, postures: Array) -> Array:
        """The least distance of every pair of parts, postures (k, n), rad → (k, pairs), m: at most SIGHT; negative
        where they are that deep in each other."""
        model, data = self._model, self._data
        found = np.full((len(postures), len(self.pairs)), SIGHT)
        with self._in_use:
            for row, posture in zip(found, postures, strict=True):
                data.qpos[self._places] = posture
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                mujoco.mj_collision(model, data)
                if data.ncon:
                    part = self._part[data.contact.geom]
                    np.minimum.at(row, self._column[part[:, 0], part[:, 1]], data.contact.dist)
        return found


def _parts(model: mujoco.MjModel, spec: HandSpec) -> Array:
    """The part of each body, (bodies,): the finger in the spec's order whose joint it hangs on, else the palm."""
    part = np.full(model.nbody, len(spec.fingers))
    mine = {int(model.joint(spec.joints[j]).bodyid[0]): k for k, f in enumerate(spec.fingers) for j in f.joints}
    for body in range(1, model.nbody):  # Parents come first.
        part[body] = mine.get(body, part[model.body_parentid[body]])
    return part
