"""A candidate as what the project plays: a scenario with its wrist, and a grasp of the library."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from allegro_twin.grasping.plan.candidate import Candidate
from allegro_twin.grasping.scenario import Scenario, Wrist
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.sim.contact.grasp_scene import Workbench
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

DIGITS = 4
"""Of angles in rad and of lengths in m, as files have them: what is proven is what is written."""


def scenario_of(candidate: Candidate, bench: Workbench, scenario: Scenario) -> Scenario:
    """The scenario with the candidate's palm."""
    away = candidate.position - np.array(bench.placed.position)
    wrist = Wrist.model_validate(
        {
            "position": row(away), "facing": row(candidate.rotation[:, 0]),
            "fingers": row(candidate.rotation[:, 2]), "retreat": row(candidate.retreat),
        }
    )  # fmt: skip
    return scenario.model_copy(update={"wrist": wrist, "hand": bench.spec.model_reference})


def grasp_of(candidate: Candidate, template: Grasp, spec: HandSpec, squeeze: float = 1.0) -> Grasp:
    """The candidate's postures as a grasp, of its template's type. `squeeze`: factor on how far the fingers are told to
    go beyond where they touch."""
    told = candidate.close + squeeze * (candidate.squeeze - candidate.close)
    preshape, close, told = (rounded(each, spec) for each in (candidate.preshape, candidate.close, told))
    return replace(template, preshape=preshape, close=close, squeeze=told, grip=None, observed=None)


def rounded(posture: Vector, spec: HandSpec) -> Vector:
    """A posture as files have it, inside the joint limits, (n,), rad."""
    fine = 10.0**DIGITS
    inside: Vector = np.clip(
        np.round(posture, DIGITS), np.ceil(spec.lower * fine) / fine, np.floor(spec.upper * fine) / fine
    )
    return inside


def row(vector: Array) -> tuple[float, float, float]:
    """Three lengths as files have them, m."""
    x, y, z = np.round(vector, DIGITS).tolist()
    return x, y, z
