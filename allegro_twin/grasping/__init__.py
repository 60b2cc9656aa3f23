"""Grasp trials: scenarios, protocols, verdicts, evaluation and planning.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.grasping.interchange.read import read_grasps
    from allegro_twin.grasping.scenario import (
        Phase,
        PhysicsSettings,
        Scenario,
        Shake,
        TrialProtocol,
        load_scenario,
    )
    from allegro_twin.grasping.timeline import make_stage
    from allegro_twin.grasping.trial import Trial
    from allegro_twin.grasping.uncertainty import Perturbation
    from allegro_twin.grasping.verdict import TrialReport, relative_displacement

__all__ = [
    "Perturbation",
    "Phase",
    "PhysicsSettings",
    "Scenario",
    "Shake",
    "Trial",
    "TrialProtocol",
    "TrialReport",
    "load_scenario",
    "make_stage",
    "read_grasps",
    "relative_displacement",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "interchange.read": ("read_grasps",),
        "scenario": (
            "Phase",
            "PhysicsSettings",
            "Scenario",
            "Shake",
            "TrialProtocol",
            "load_scenario",
        ),
        "timeline": ("make_stage",),
        "trial": ("Trial",),
        "uncertainty": ("Perturbation",),
        "verdict": (
            "TrialReport",
            "relative_displacement",
        ),
    },
)
