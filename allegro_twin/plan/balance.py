"""Could these contacts hold it? Forces inside friction cones that balance each other, and that carry the weight."""

from __future__ import annotations

import numpy as np

from allegro_twin.evaluate.metrics.contacts import Contacts, contacts, wrenches
from allegro_twin.evaluate.metrics.needs import scipy_part
from allegro_twin.sim.workbench import Meetings
from allegro_twin.types import Array

LEVER = 0.04
"""m: what makes a moment a force, about the radius of what a hand holds."""
UNBALANCED = 0.25
"""More of every newton than this is left over: the fingers would push the object away."""
_HEAVY = 10.0  # The weight of Σ x = 1 among the equations.


def gripped(touch: Meetings, centre: Array, friction: float) -> Contacts:
    """What a workbench has found, as contacts of which metrics are taken."""
    return contacts(touch.points, touch.normals, friction, centre=centre, length=LEVER)


def imbalance(held: Contacts) -> float:
    """How far contacts that press with 1 in all are from balancing each other: min |Σ xᵢ wᵢ| over x ≥ 0, Σ xᵢ = 1."""
    columns = wrenches(held).T
    equations = np.concatenate([columns, np.full((1, columns.shape[1]), _HEAVY)])
    forces, _ = scipy_part("optimize").nnls(equations, np.array([0.0] * 6 + [_HEAVY]))
    total = float(forces.sum())
    return float(np.linalg.norm(columns @ forces)) / total if total > 1e-9 else np.inf
