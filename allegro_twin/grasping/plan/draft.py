"""A first guess at a grasp, without a trial: where a file of one's own begins."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from allegro_twin.control.controllers import Gains
from allegro_twin.errors import ConfigError
from allegro_twin.grasping.plan.candidate import candidate_grasp, candidate_scenario
from allegro_twin.grasping.plan.close_in_simulation import OVER
from allegro_twin.grasping.plan.proposals.propose import Proposer
from allegro_twin.grasping.plan.templates import grasp_templates
from allegro_twin.grasping.scenario import Scenario, load_protocol
from allegro_twin.grasping.timeline import make_stage
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.sim.contact.grasp_scene import GraspScene
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

LOOKED, SHARE = 40, 0.6
"""Proposals of which the best is taken, and the share of the torque limit that it squeezes with."""


def first_guess(scenario: Scenario, spec: HandSpec, folder: Path = Path(), seed: int = 0) -> tuple[Scenario, Grasp]:
    """A palm that looks at the object, free of it and of the table, and fingers that close on it: in geometry alone, so
    that nothing says yet that it holds. Raises ConfigError for an object that no hand fits around."""
    bench = GraspScene(spec, make_stage(scenario, load_protocol(scenario.protocol), spec.side, folder))
    found, known = [], grasp_templates(spec)
    proposer = Proposer(bench, known, scenario.friction, (0.0,), np.random.default_rng(seed))
    for candidate in filter(None, proposer.fresh(tries=20_000)):
        found.append(candidate)
        if len(found) == LOOKED:
            break
    if not found:
        raise ConfigError(f"{scenario.objects[0].name}: no palm was found from which fingers can close on it")
    best = max(found, key=lambda candidate: candidate.score)
    template = next(grasp for grasp in known if grasp.name == best.template)
    close = candidate_grasp(best, template, spec)
    return candidate_scenario(best, bench, scenario), _squeezed(close, best.closing, spec, load_gains("default", spec))


def _squeezed(grasp: Grasp, closing: Array, spec: HandSpec, gains: Gains) -> Grasp:
    further = OVER * SHARE * spec.actuation.torque_limit * closing / gains.kp
    return replace(grasp, squeeze=np.clip(np.round(grasp.close + further, 4), spec.lower, spec.upper))
