"""Ground truth of a simulation: poses of palm and object, and contact forces."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.sim.model.contact_forces import contact_forces
from allegro_twin.sim.model.joints import PostureMap
from allegro_twin.sim.model.parts import body_parts, part_names
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, frozen


class _Contacts(NamedTuple):
    """Contacts of the object, k of them."""

    rows: NDArray[np.int64]
    """Which of the scene's they are, (k,)."""
    first: NDArray[np.bool_]
    """Where the object is the first of the two that touch, (k,)."""
    part: NDArray[np.int64]
    """Part of the hand in each contact, (k,); negative for none."""
    on_table: bool
    local: Array
    """The force in each contact's own frame, (k, 3), N."""


class ObjectProbe:
    """Looks into a scene at one object, after each period."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, spec: HandSpec, object_name: str) -> None:
        self._model, self._data = model, data
        self._palm, self._object = model.body("palm_link").id, model.body(object_name).id
        self.parts = part_names(spec)
        self._n, self._parts_column = len(self.parts), np.arange(len(self.parts))[:, None]
        # An object, and what stands on the table, may be made of bodies that are welded together.
        weld = model.body_weldid[model.geom_bodyid]
        self._part = body_parts(model, spec)[model.geom_bodyid]
        self._is_object, self._stands = weld == self._object, (weld == 0) & (self._part < 0)
        empty = {"contact_force": self._n, "on_table": 1, "contacts": 1, "penetration": 1}
        self._untouched = {name: frozen(np.zeros(size)) for name, size in empty.items()}
        self._unmoved = frozen(np.full(3 * self._n, np.nan)), frozen(np.zeros(3 * self._n))

    def __call__(self) -> dict[str, Array]:
        """What `touch` has, and `palm` and `object`: position and quaternion in the world, (7,). `contact_point` and
        `contact_vector`, (3 parts,): where each part presses on the object, m, world, and the whole force with friction
        by which it does, N, world; the point is NaN where nothing touches."""
        data, found = self._data, self._contacts()
        point, vector = self._unmoved if found is None else self._pressing(found)
        return self._felt(found) | {
            "palm": np.concatenate([data.xpos[self._palm], data.xquat[self._palm]]),
            "object": np.concatenate([data.xpos[self._object], data.xquat[self._object]]),
            "contact_point": point,
            "contact_vector": vector,
        }

    def touch(self) -> dict[str, Array]:
        """`contact_force`: the sum of normal forces on the object by each finger and the palm, (fingers + 1,), N.
        `on_table`: 1 where it touches the table or its stand, (1,). `contacts`: how many points of the hand touch it,
        (1,), and `penetration`, (1,): the deepest of them, m."""
        return self._felt(self._contacts())

    def _contacts(self) -> _Contacts | None:
        contact = self._data.contact
        geoms, address = contact.geom, contact.efc_address
        ours = self._is_object[geoms]
        mine = ((ours[:, 0] | ours[:, 1]) & (address >= 0)).nonzero()[0]
        if not len(mine):
            return None
        first = ours[mine, 0]
        other = np.where(first, geoms[mine, 1], geoms[mine, 0])
        local = contact_forces(self._model, self._data, mine)
        return _Contacts(mine, first, self._part[other], bool(self._stands[other].any()), local)

    def _felt(self, found: _Contacts | None) -> dict[str, Array]:
        if found is None:
            return dict(self._untouched)
        hand = found.part >= 0
        depth = -self._data.contact.dist[found.rows[hand]].min(initial=0.0)
        return {
            "contact_force": (found.part == self._parts_column) @ found.local[:, 0],
            "on_table": np.array([float(found.on_table)]),
            "contacts": np.array([float(hand.sum())]),
            "penetration": np.array([max(depth, 0.0)]),
        }

    def _pressing(self, found: _Contacts) -> tuple[Array, Array]:
        contact, local = self._data.contact, found.local
        rows = np.empty((len(local), 7))
        rows[:, 0] = local[:, 0]
        rows[:, 1:4] = local[:, :1] * contact.pos[found.rows]
        toward = np.where(found.first[:, None], -local, local)
        rows[:, 4:] = (toward[:, None] @ contact.frame[found.rows].reshape(-1, 3, 3))[:, 0]
        total = (found.part == self._parts_column) @ rows
        weights = total[:, 0].copy()
        weights[weights <= 0.0] = np.nan
        return (total[:, 1:4] / weights[:, None]).reshape(-1), total[:, 4:].reshape(-1)


def contact_free_postures(model: mujoco.MjModel, spec: HandSpec, postures: Array, count: int) -> Array:
    """The first `count` of some postures (k, n), rad, in which nothing of the scene touches, (count, n). Raises
    ConfigError where there is none, which names two bodies that touch, and for no postures at all."""
    if not len(postures):
        raise ConfigError(f"{spec.name}: no postures to look for one in which nothing touches: give one or more")
    data = mujoco.MjData(model)
    posed = PostureMap(spec, model)
    found: list[Array] = []
    for posture in postures:
        posed(posture, data.qpos)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        if data.ncon == 0:
            found.append(posture)
        if len(found) == count:
            break
    if not found:
        first, second = (model.body(model.geom_bodyid[geom]).name for geom in data.contact.geom[0])
        raise ConfigError(
            f"{spec.name}: something touches in each of {len(postures)} postures, such as {first} and {second}: where "
            "they overlap at rest move them apart in the model, or let the pair through each other"
        )
    return np.array(found)
