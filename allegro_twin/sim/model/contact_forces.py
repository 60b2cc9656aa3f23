"""Contact forces of a scene, of many scenes at once."""

from __future__ import annotations

import mujoco
import numpy as np

from allegro_twin.sim.model.parts import Indices
from allegro_twin.types import Array

_AXES = np.arange(3)


def contact_forces(model: mujoco.MjModel, data: mujoco.MjData, contacts: Indices) -> Array:
    """Forces of contacts by number, along their normal and two tangents, (k, 3), N; zero where one is not in the
    solver. As `mj_contactForce`, of many at once."""
    if model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL:
        found = np.zeros((len(contacts), 6))
        for row, index in zip(found, contacts.tolist(), strict=True):
            mujoco.mj_contactForce(model, data, index, row)
        return found[:, :3]
    first, size = data.contact.efc_address[contacts, None], data.contact.dim[contacts, None]
    has = (first >= 0) & (size > _AXES)
    forces = data.efc_force
    if has.all():
        found = forces[first + _AXES]
    else:
        found = np.zeros((len(contacts), 3))
        found[has] = forces[(first + _AXES)[has]]
    return found
