"""What only a simulation knows: where the palm and an object are, and who presses how hard."""

from __future__ import annotations

import mujoco
import numpy as np

from allegro_twin.sim.backend import SimBackend
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

_AXES = np.arange(3)  # Of an elliptic contact's force: along the normal, along two tangents.


class Probe:
    """Looks into the scene of a backend at one object, after each period."""

    def __init__(self, backend: SimBackend, thing: str) -> None:
        model = backend.model
        self._data, self._model = backend.data, model
        self._palm, self._thing = model.body("palm_link").id, model.body(thing).id
        # Each geom's group: 0 for the object, 1… for the fingers in the spec's order, last the palm; -1 for the rest.
        self.parts = (*(finger.name for finger in backend.spec.fingers), "palm")
        self._part = np.full(model.ngeom, -1)
        for number, finger in enumerate(backend.spec.fingers):
            for joint in finger.joints:
                body = model.joint(backend.spec.joints[joint]).bodyid[0]
                self._part[model.geom_bodyid == body] = number
        self._part[model.geom_bodyid == self._palm] = len(self.parts) - 1

    def __call__(self) -> dict[str, Array]:
        """`palm` and `object`: position and quaternion in the world, (7,). `contact_force`: the sum of normal forces
        on the object by each finger and the palm, (fingers + 1,), N. `on_table`: 1 where it touches the table or its
        stand, (1,). `contact_point` and `contact_vector`, (3 parts,): where each part presses on the object, m, world,
        and the whole force with friction by which it does, N, world; the point is NaN where nothing touches."""
        data = self._data
        force, on_table, point, vector = self._contacts()
        return {
            "palm": np.concatenate([data.xpos[self._palm], data.xquat[self._palm]]),
            "object": np.concatenate([data.xpos[self._thing], data.xquat[self._thing]]),
            "contact_force": force,
            "on_table": on_table,
            "contact_point": point,
            "contact_vector": vector,
        }

    def _contacts(self) -> tuple[Array, Array, Array, Array]:
        contact, forces = self._data.contact, self._data.efc_force
        pairs, address = contact.geom, contact.efc_address
        bodies = self._model.geom_bodyid[pairs]
        mine = (bodies == self._thing).any(axis=1) & (address >= 0)
        address, pairs, bodies = address[mine], pairs[mine], bodies[mine]
        normal = forces[address]
        second = bodies[:, 0] != self._thing
        other = np.where(second, pairs[:, 0], pairs[:, 1])
        part, count = self._part[other], len(self.parts)
        by_hand, part = part >= 0, part[part >= 0]
        by_part = np.bincount(part, weights=normal[by_hand], minlength=count).astype(np.float64)
        # MuJoCo's contact frame has the normal, from the first geom to the second, and two tangents as its rows.
        local = forces[address[by_hand, None] + _AXES] * np.where(second[by_hand], 1.0, -1.0)[:, None]
        world = (local[:, None] @ contact.frame[mine][by_hand].reshape(-1, 3, 3))[:, 0]
        vector, point = np.zeros((count, 3)), np.zeros((count, 3))
        np.add.at(vector, part, world)
        np.add.at(point, part, normal[by_hand, None] * contact.pos[mine][by_hand])
        point = np.where(by_part[:, None] > 0, point / np.where(by_part > 0, by_part, 1.0)[:, None], np.nan)
        on_table = np.array([float((self._model.geom_bodyid[other] == 0).any())])
        return by_part, on_table, point.reshape(-1), vector.reshape(-1)


def free_of_contact(model: mujoco.MjModel, spec: HandSpec, postures: Array, count: int) -> Array:
    """The first `count` of some postures (k, n), rad, in which nothing of the scene touches, (count, n)."""
    data = mujoco.MjData(model)
    places = [int(model.joint(name).qposadr[0]) for name in spec.joints]
    found = []
    for posture in postures:
        data.qpos[places] = posture
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        if data.ncon == 0:
            found.append(posture)
        if len(found) == count:
            break
    return np.array(found)
