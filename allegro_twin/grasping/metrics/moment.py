"""The metrics of a trial at one moment of it: of the contacts that it then has."""

from __future__ import annotations

from typing import Any

from allegro_twin.grasping.metrics.measure import measured
from allegro_twin.grasping.trial import Trial
from allegro_twin.sim.contact.contacts import jacobians, touching

NAMES = ("fingers", "epsilon", "volume", "lp", "qp", "carry", "least_torque")
"""As `measure.measured` has them; its `torque_share` is called `least_torque` here, beside the share that was used."""


def metrics_of(trial: Trial, data: Any) -> dict[str, float]:
    """`NAMES` of a trial in the state `data`, an MjData that a step or `mj_forward` has left. `least_torque` is NaN
    for a hand with joints that nobody drives: springs decide there, too. Raises ConfigError without SciPy."""
    model, spec = trial.backend.model, trial.backend.spec
    touch = touching(model, data, spec, trial.scenario.objects[0].name)
    columns = None if spec.followers else jacobians(model, data, spec, touch)
    row = measured(touch, trial.mass, columns, spec.actuation.torque_limit)
    row["least_torque"] = row.get("torque_share", float("nan"))
    return {name: row[name] for name in NAMES}
