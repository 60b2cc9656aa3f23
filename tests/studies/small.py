"""A study that takes seconds, and rows that nobody had to simulate."""

from __future__ import annotations

from typing import Any

import numpy as np

from studies.preemption.draws import case
from studies.preemption.protocol import ArmStudy, SpringStudy, Study, load_study, study_of


def content(**changed: Any) -> dict[str, Any]:
    """The registered protocol with few objects, cells and seconds."""
    plain = load_study("preemption").model_dump(mode="json")
    motion = plain["motion"] | {"lifting": 0.4, "hold": 0.5, "shaking": 0.75}
    strata = {"position": [0.0, 0.01], "yaw": [0.0], "friction": [0.7, 1.0], "approach": [0.6]}
    small = {
        "hands": {"model_o": "model_o_{object}"}, "train": ["foam_brick"], "test": ["gelatin_box"], "strata": strata,
        "pairs": {"train": 2, "test": 4}, "motion": motion,
        "controls": {"frozen": {"every": 2, "policies": ["P0e"], "frozen": True},
                     "weightless": {"every": 2, "policies": ["P0e"], "certain": True, "gravity": 0.0},
                     "seeds": {"every": 2, "policies": ["P0e"], "stream": 1}},
    }  # fmt: skip
    return plain | small | changed


def study(**changed: Any) -> SpringStudy:
    made = study_of(content(**changed), "a test")
    assert isinstance(made, SpringStudy)
    return made


def arm_study(**changed: Any) -> ArmStudy:
    """With the arm in the loop: one hand, two objects, and few seconds."""
    plain = load_study("preemption_arm").model_dump(mode="json")
    motion = plain["motion"] | {"hold": 0.4, "shaking": 0.75}
    strata = plain["strata"] | {"position": [0.0, 0.01], "yaw": [0.0], "friction": [0.7, 1.0], "approach": [0.8]}
    small = {
        "hands": {"allegro": "lab_allegro"}, "train": ["train_ball"], "test": ["small_ball"], "strata": strata,
        "pairs": {"train": 2, "test": 4}, "motion": motion, "check": plain["check"] | {"samples": 20},
        "controls": {"frozen": {"every": 2, "policies": ["A"], "frozen": True}},
    }  # fmt: skip
    made = study_of(plain | small | changed, "a test")
    assert isinstance(made, ArmStudy)
    return made


def rows(of: Study, rate: dict[str, float], seed: int = 0) -> list[dict[str, Any]]:
    """Of all trials of test and train, held at a rate for each policy by one number a trial, so that policies with the
    same rate agree; a cycle is 3 s less the overlap's part of the closing time."""
    found = []
    for hand in of.hands:
        for set_ in ("train", "test"):
            for trial in range(getattr(of.pairs, set_)):
                luck = np.random.default_rng([seed, trial, set_ == "test"]).uniform()
                drawn = case(of, set_, trial)
                found += [
                    {"hand": hand, "set": set_, "trial": trial, "policy": policy.name, "control": "",
                     "object": drawn.object, "sigma_mm": 1e3 * drawn.sigma, "sigma_deg": drawn.sigma_yaw,
                     "approach_s": drawn.approach, "held": bool(luck < rate[policy.name]),
                     "said_held": True, "cycle_s": 3.0 - policy.overlap * of.motion.close, "premature_s": 0.0,
                     "carried_mm": 0.0, "peak_n": 1.0}
                    for policy in of.policies
                ]  # fmt: skip
    return found
