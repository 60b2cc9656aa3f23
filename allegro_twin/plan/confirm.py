"""A candidate as what the project plays: a scenario with its wrist, and a grasp of the library."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from allegro_twin.evaluate.scenario import Scenario, Wrist
from allegro_twin.library.grasps import Grasp
from allegro_twin.plan.candidate import Candidate
from allegro_twin.sim.workbench import Workbench
from allegro_twin.types import Array

DIGITS = 4
"""Of angles in rad and of lengths in m, as files have them: what is proven is what is written."""


def scenario_of(candidate: Candidate, bench: Workbench, scenario: Scenario) -> Scenario:
    """The scenario with the candidate's palm."""
    away = candidate.position - np.array(bench.placed.position)
    wrist = Wrist.model_validate(
        {
            "position": _rounded(away), "facing": _rounded(candidate.rotation[:, 0]),
            "fingers": _rounded(candidate.rotation[:, 2]), "retreat": _rounded(candidate.retreat),
        }
    )  # fmt: skip
    return scenario.model_copy(update={"wrist": wrist})


def grasp_of(candidate: Candidate, template: Grasp, bench: Workbench, squeeze: float = 1.0) -> Grasp:
    """The candidate's postures as a grasp, of its template's type. `squeeze`: factor on how far the fingers are told to
    go beyond where they touch."""
    spec = bench.spec
    told = candidate.close + squeeze * (candidate.squeeze - candidate.close)
    preshape, close, told = (
        np.clip(np.round(each, DIGITS), np.ceil(spec.lower * 1e4) / 1e4, np.floor(spec.upper * 1e4) / 1e4)
        for each in (candidate.preshape, candidate.close, told)
    )
    return replace(template, preshape=preshape, close=close, squeeze=told, grip=None)


def _rounded(vector: Array) -> tuple[float, float, float]:
    x, y, z = np.round(vector, DIGITS).tolist()
    return x, y, z
