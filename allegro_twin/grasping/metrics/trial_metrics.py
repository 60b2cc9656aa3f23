"""All the figures of one moment of a grasp, as a row of a table."""

from __future__ import annotations

from typing import Any

import numpy as np

from allegro_twin.grasping.metrics.carrying import least_effort, least_normal_force, weight_load
from allegro_twin.grasping.metrics.contacts import EDGES, Contacts, make_contacts
from allegro_twin.grasping.metrics.quality import closure_margin, grasp_quality, qp_residual
from allegro_twin.grasping.trial import Trial
from allegro_twin.sim.contact.contacts import SceneContacts, contact_jacobians, find_contacts
from allegro_twin.types import Array, Vector


def contacts_in_scene(touch: SceneContacts, friction: float | None = None) -> Contacts:
    """The contacts of a scene for the metrics; `friction` replaces the scene's sliding friction."""
    return make_contacts(
        touch.points,
        touch.normals,
        touch.friction if friction is None else friction,
        touch.torsion,
        centre=touch.centre,
        length=touch.length,
        tangents=touch.tangents,
    )


def contact_metrics(
    touch: SceneContacts,
    mass: float,
    jacobians: Array | None = None,
    limit: Vector | None = None,
    *,
    down: tuple[float, float, float] = (0.0, 0.0, -1.0),
    friction: float | None = None,
    edges: int = EDGES,
) -> dict[str, float]:
    """`contacts`, `fingers` (parts that touch), `penetration_mm`, `epsilon`, `volume`, `lp`, `qp`, `carry` (N) and,
    with Jacobians (k, 6, n) and torque limits (n,), `torque_share`: the columns of a report. A limit that is
    unknown is inf, and the share then NaN. `mass`: kg, of which the weight points `down` in the world. Raises
    ConfigError without SciPy."""
    all_of_them = contacts_in_scene(touch, friction)
    found, load = grasp_quality(all_of_them, edges), weight_load(mass, down)
    row = {
        "contacts": float(len(touch.points)),
        "fingers": float(len(np.unique(touch.part))),
        "penetration_mm": 1000.0 * float(touch.depth.max(initial=0.0)),
        "epsilon": found.epsilon,
        "volume": found.volume,
        "lp": closure_margin(all_of_them, edges),
        "qp": qp_residual(all_of_them, edges),
        "carry": float(least_normal_force(all_of_them, load, edges)[0]),
    }
    if jacobians is not None and limit is not None:
        known = np.isfinite(limit).all()
        share = least_effort(all_of_them, jacobians, limit, load, edges).share if known else float("nan")
        row["torque_share"] = share
    return row


NAMES = ("fingers", "epsilon", "volume", "lp", "qp", "carry", "least_torque")
"""Names of `contact_metrics`; its `torque_share` is `least_torque` here, beside the share that was used."""


def trial_metrics(trial: Trial, data: Any) -> dict[str, float]:
    """`NAMES` of a trial in the state `data`, an MjData that a step or `mj_forward` has left. `least_torque` is NaN
    for a hand with joints that nobody drives, for springs decide there, too, and where the effort of a motor is
    unknown. Raises ConfigError without SciPy."""
    model, spec = trial.backend.model, trial.backend.spec
    touch = find_contacts(model, data, spec, trial.scenario.objects[0].name)
    columns = None if spec.followers else contact_jacobians(model, data, spec, touch)
    row = contact_metrics(touch, trial.mass, columns, spec.actuation.torque_limit)
    row["least_torque"] = row.get("torque_share", float("nan"))
    return {name: row[name] for name in NAMES}
