"""What only a simulation knows: where the palm and an object are, and who presses how hard."""

from __future__ import annotations

import mujoco
import numpy as np

from allegro_twin.sim.parts import part_names, parts_of
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, frozen

_AXES = np.arange(3)  # Of an elliptic contact's force: along the normal, along two tangents.


class Probe:
    """Looks into a scene at one object, after each period."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, spec: HandSpec, thing: str) -> None:
        self._data = data
        self._palm, self._thing = model.body("palm_link").id, model.body(thing).id
        self.parts = part_names(spec)
        self._n, self._parts_column = len(self.parts), np.arange(len(self.parts))[:, None]
        # An object, and what stands on the table, may be made of bodies that are welded together.
        weld = model.body_weldid[model.geom_bodyid]
        self._part = parts_of(model, spec)[model.geom_bodyid]
        self._is_thing, self._stands = weld == self._thing, (weld == 0) & (self._part < 0)
        empty = (np.zeros(self._n), np.full(3 * self._n, np.nan), np.zeros(3 * self._n), np.zeros(1), np.zeros(1))
        self._nothing = tuple(frozen(array) for array in empty)

    def __call__(self) -> dict[str, Array]:
        """`palm` and `object`: position and quaternion in the world, (7,). `contact_force`: the sum of normal forces
        on the object by each finger and the palm, (fingers + 1,), N. `on_table`: 1 where it touches the table or its
        stand, (1,). `contact_point` and `contact_vector`, (3 parts,): where each part presses on the object, m, world,
        and the whole force with friction by which it does, N, world; the point is NaN where nothing touches.
        `contacts`: how many points of the hand touch it, (1,), and `penetration`, (1,): the deepest of them, m."""
        data = self._data
        force, on_table, point, vector, contacts, depth = self._contacts()
        return {
            "palm": np.concatenate([data.xpos[self._palm], data.xquat[self._palm]]),
            "object": np.concatenate([data.xpos[self._thing], data.xquat[self._thing]]),
            "contact_force": force,
            "on_table": on_table,
            "contact_point": point,
            "contact_vector": vector,
            "contacts": contacts,
            "penetration": depth,
        }

    def _contacts(self) -> tuple[Array, Array, Array, Array, Array, Array]:
        contact = self._data.contact
        geoms, address = contact.geom, contact.efc_address
        ours = self._is_thing[geoms]
        mine = ((ours[:, 0] | ours[:, 1]) & (address >= 0)).nonzero()[0]
        if not len(mine):
            force, point, vector, contacts, depth = self._nothing
            return force, np.zeros(1), point, vector, contacts, depth
        geoms, first, address = geoms[mine], ours[mine, 0], address[mine]
        other = np.where(first, geoms[:, 1], geoms[:, 0])
        part = self._part[other]
        on_table = np.array([float(self._stands[other].any())])
        # MuJoCo's contact frame has the normal, from the first geom to the second, and two tangents as its rows.
        local = self._data.efc_force[address[:, None] + _AXES]
        rows = np.empty((len(mine), 7))
        rows[:, 0] = local[:, 0]
        rows[:, 1:4] = local[:, :1] * contact.pos[mine]
        toward = np.where(first[:, None], -local, local)
        rows[:, 4:] = (toward[:, None] @ contact.frame[mine].reshape(-1, 3, 3))[:, 0]
        total = (part == self._parts_column) @ rows
        by_part = total[:, 0]
        weights = by_part.copy()
        weights[weights <= 0.0] = np.nan
        point = total[:, 1:4] / weights[:, None]
        hand = part >= 0
        depth = np.array([max(-contact.dist[mine[hand]].min(initial=0.0), 0.0)])
        return by_part, on_table, point.reshape(-1), total[:, 4:].reshape(-1), np.array([float(hand.sum())]), depth


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
