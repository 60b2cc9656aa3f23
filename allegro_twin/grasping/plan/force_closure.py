"""Could these contacts hold it? Forces inside friction cones that balance each other, and that carry the weight."""

from __future__ import annotations

import numpy as np

from allegro_twin.grasping.metrics.contacts import Contacts, contacts, wrenches
from allegro_twin.grasping.metrics.nearest import nearest
from allegro_twin.sim.contact.grasp_scene import Meetings, Workbench
from allegro_twin.types import Array

LEVER = 0.04
"""m: what makes a moment a force, about the radius of what a hand holds."""
UNBALANCED = 0.25
"""More of every newton than this is left over: the fingers would push the object away."""


def gripped(touch: Meetings, centre: Array, friction: float, torsion: float = 0.0) -> Contacts:
    """What a workbench has found, as contacts of which metrics are taken; `torsion`: of each, m."""
    return contacts(touch.points, touch.normals, friction, torsion, centre=centre, length=LEVER)


def torsion_of(bench: Workbench) -> float:
    """Counted for a hand of two fingers alone, m: about the line between them nothing else resists."""
    return float(bench.model.geom_friction[:, 1].max()) if len(bench.spec.fingers) == 2 else 0.0


def imbalance(held: Contacts) -> float:
    """How far contacts that press with 1 in all are from balancing each other: min |Σ xᵢ wᵢ| over x ≥ 0, Σ xᵢ = 1, the
    distance of the origin from the hull of the wrenches."""
    corners = wrenches(held)
    return float(np.linalg.norm(nearest(lambda way: corners[int(np.argmin(corners @ way))], 6)))
