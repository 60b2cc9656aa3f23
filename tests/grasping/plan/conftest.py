"""One search in the air that several tests look at."""

from __future__ import annotations

import pytest

from allegro_twin.grasping.plan.search import GraspSearch, RoundSize, SearchBudget
from allegro_twin.grasping.plan.templates import grasp_templates
from allegro_twin.grasping.plan.validate import PlannedGrasp
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.surfaces.cli.grasps.plan import scenario_of


@pytest.fixture(scope="session")
def in_the_air() -> tuple[GraspSearch, PlannedGrasp]:
    """A ball that is held against pushes along every axis, without a table and without weight."""
    spec = load_spec()
    scenario = scenario_of("tennis_ball", "z", None, None, 0.8).model_copy(update={"protocol": "fc"})
    search = GraspSearch(scenario, spec, grasp_templates(spec), effort=RoundSize(guessed=24, closed=8, drawn=3))
    (planned,) = search.run(1, SearchBudget(80))
    return search, planned
