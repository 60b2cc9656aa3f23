"""Which part of a hand a body is: one of its fingers, or the palm."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.spec import HandSpec

PALM = "palm"
Indices = NDArray[np.int_]


def part_names(spec: HandSpec) -> tuple[str, ...]:
    """The fingers in the spec's order, last the palm."""
    return (*(finger.name for finger in spec.fingers), PALM)


def parts_of(model: mujoco.MjModel, spec: HandSpec) -> Indices:
    """The number of each body's part in `part_names`, (bodies,): the finger whose joint it hangs on, by however many
    welds, else the palm; -1 for what is not the hand."""
    part = np.full(model.nbody, -1)
    part[model.body("palm_link").id] = len(spec.fingers)
    mine = {int(model.joint(spec.joints[j]).bodyid[0]): k for k, f in enumerate(spec.fingers) for j in f.joints}
    for body in range(1, model.nbody):  # Parents come first.
        if part[body] < 0:
            part[body] = mine.get(body, part[model.body_parentid[body]])
    return part
