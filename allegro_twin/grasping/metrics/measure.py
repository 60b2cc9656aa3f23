"""All the figures of one moment of a grasp, as a row of a table."""

from __future__ import annotations

import numpy as np

from allegro_twin.grasping.metrics.carrying import least_effort, least_normal_force, weight
from allegro_twin.grasping.metrics.closure import margin, residual
from allegro_twin.grasping.metrics.contacts import EDGES, Contacts, contacts
from allegro_twin.grasping.metrics.quality import quality
from allegro_twin.sim.contact.contacts import Touch
from allegro_twin.types import Array, Vector


def of_touch(touch: Touch, friction: float | None = None) -> Contacts:
    """The contacts of a scene for the metrics; `friction` replaces the scene's sliding friction."""
    return contacts(
        touch.points,
        touch.normals,
        touch.friction if friction is None else friction,
        touch.torsion,
        centre=touch.centre,
        length=touch.length,
        tangents=touch.tangents,
    )


def measured(
    touch: Touch,
    mass: float,
    jacobians: Array | None = None,
    limit: Vector | None = None,
    *,
    down: tuple[float, float, float] = (0.0, 0.0, -1.0),
    friction: float | None = None,
    edges: int = EDGES,
) -> dict[str, float]:
    """`contacts`, `fingers` (parts that touch), `penetration_mm`, `epsilon`, `volume`, `lp`, `qp`, `carry` (N) and,
    with Jacobians (k, 6, n) and torque limits (n,), `torque_share`: the columns of a report. `mass`: kg, of which the
    weight points `down` in the world. Raises ConfigError without SciPy."""
    all_of_them = of_touch(touch, friction)
    found, load = quality(all_of_them, edges), weight(mass, down)
    row = {
        "contacts": float(len(touch.points)),
        "fingers": float(len(np.unique(touch.part))),
        "penetration_mm": 1000.0 * float(touch.depth.max(initial=0.0)),
        "epsilon": found.epsilon,
        "volume": found.volume,
        "lp": margin(all_of_them, edges),
        "qp": residual(all_of_them, edges),
        "carry": float(least_normal_force(all_of_them, load, edges)[0]),
    }
    if jacobians is not None and limit is not None:
        row["torque_share"] = least_effort(all_of_them, jacobians, limit, load, edges).share
    return row
