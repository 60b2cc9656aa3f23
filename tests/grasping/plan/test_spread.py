"""Several searches find what each of them finds, wherever they run."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
import pytest

from allegro_twin.grasping.plan.candidate import Candidate
from allegro_twin.grasping.plan.parallel import planned_from_json, planned_to_json, run_searches, search_in_parallel
from allegro_twin.grasping.plan.search import GraspSearch, RoundSize, SearchBudget
from allegro_twin.grasping.plan.templates import grasp_templates
from allegro_twin.grasping.plan.validate import SEARCHED, PlannedGrasp
from allegro_twin.grasping.scenario import load_scenario
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.surfaces.cli.grasps.plan import scenario_of
from allegro_twin.sweep.local import Local

SPEC = load_spec()
LITTLE = RoundSize(guessed=24, closed=8, drawn=2)


def test_a_grasp_crosses_to_another_process_and_back_as_it_is() -> None:
    scenario, _ = load_scenario("lemon")
    grasp = load_grasp(scenario.grasp, SPEC)
    numbers = np.random.default_rng(0).normal(size=(5, SPEC.n_joints))
    a, b, c, d, e = numbers
    candidate = Candidate(a[:3], np.eye(3), b[:3], a, b, c, d, e, grasp.name, 0.5)
    made = PlannedGrasp(candidate, scenario, grasp, 8, 7, 20, 14, 3, 48, True, False, 0.25, 0.5, 0.4)
    again = planned_from_json(json.loads(json.dumps(planned_to_json(made))), [grasp])
    assert planned_to_json(again) == planned_to_json(made)
    for name in Candidate.__slots__:
        np.testing.assert_array_equal(getattr(again.candidate, name), getattr(candidate, name))
    assert again.scenario == scenario
    assert again.expected == made.expected
    np.testing.assert_array_equal(again.grasp.squeeze, grasp.squeeze)


@pytest.mark.long
def test_of_two_searches_side_by_side_the_better_grasp_counts() -> None:
    scenario = scenario_of("tennis_ball", "z", None, None, 0.8)
    shared = {
        "scenario": scenario.model_dump(mode="json"), "folder": ".", "hand": "allegro", "side": "right", "twin": "",
        "kind": None, "n": 1, "uncertainty": SEARCHED.model_dump(mode="json"),
        "budget": {"candidates": 24}, "region": None, "effort": asdict(LITTLE),
    }  # fmt: skip
    known = grasp_templates(SPEC)
    rows = run_searches(shared, [{"seed": 0}, {"seed": 1}])
    each = [planned_from_json(json.loads(row["found"])[0], known) for row in rows]
    assert planned_to_json(each[0]) == json.loads(rows[0]["found"])[0]
    search = GraspSearch(scenario, SPEC, known, seed=0, effort=LITTLE)
    (best,) = search_in_parallel(search, 1, SearchBudget(24), 2, Local(0))
    better = max(each, key=lambda planned: (planned.expected, planned.candidate.score))
    np.testing.assert_array_equal(best.grasp.squeeze, better.grasp.squeeze)
    for counted, name in ((search.ends, "ends"), (search.drawn, "drawn")):
        assert sum(counted.values()) == sum(sum(json.loads(row[name]).values()) for row in rows)
