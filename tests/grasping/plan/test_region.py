"""An object is held by a part of it where that is asked for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.batch.batched_trials import Verdict
from allegro_twin.grasping.batch.trials import TrialRunner, load_case
from allegro_twin.grasping.plan.candidate import object_symmetry
from allegro_twin.grasping.plan.proposals.propose import BATCH, Proposer
from allegro_twin.grasping.plan.region import parse_region, to_object_frame
from allegro_twin.grasping.plan.search import GraspSearch
from allegro_twin.grasping.plan.templates import grasp_templates
from allegro_twin.grasping.plan.validate import GraspValidator, PlannedGrasp, validate_in_air
from allegro_twin.grasping.scenario import load_protocol
from allegro_twin.grasping.timeline import make_stage
from allegro_twin.grasping.uncertainty import Uncertainty
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.contact.grasp_scene import GraspScene
from allegro_twin.surfaces.cli.grasps.plan import scenario_of

SPEC = load_spec()


@pytest.mark.parametrize("text", ["", "x=3", "w>0", "x>0.1,x<0.05", "x>a"])
def test_bounds_that_say_nothing_are_an_error(text: str) -> None:
    with pytest.raises(ConfigError, match="region"):
        parse_region(text)


def test_a_region_has_what_is_between_its_bounds() -> None:
    """Bounds that are not said are none."""
    points = np.array([[0.05, 0.0, 9.0], [0.04, 0.0, 0.0], [0.05, 0.0, -0.1]])
    assert parse_region(" x > 0.045 , z<.5").contains(points).tolist() == [False, False, True]
    assert str(parse_region(" x > 0.045 , z<.5")) == "x > 0.045, z < 0.5"
    assert parse_region("z>-0.05").contains(points).tolist() == [True, True, False]


def test_fingers_that_are_proposed_touch_mostly_in_the_region() -> None:
    """The upper half of a can that stands on the table."""
    scenario, upper = scenario_of("tomato_soup_can", "z", None, None, 0.8), parse_region("z>0.01")
    bench = GraspScene(SPEC, make_stage(scenario, load_protocol("table_pick"), "right", Path()))
    proposer = Proposer(bench, grasp_templates(SPEC), 0.8, (0.0,), np.random.default_rng(0), region=upper)
    found = [candidate for candidate, _ in zip(filter(None, proposer.fresh()), range(5), strict=False)]
    assert len(found) == 5
    for candidate in found:
        bench.place(candidate.position, candidate.rotation, candidate.close)
        points = to_object_frame(bench.placed, bench.touch().points)
        assert (points[:, 2] > 0.01).mean() > 0.5


def test_a_region_without_a_surface_is_an_error() -> None:
    scenario = scenario_of("tomato_soup_can", "z", None, None, 0.8)
    bench = GraspScene(SPEC, make_stage(scenario, load_protocol("table_pick"), "right", Path()))
    proposer = Proposer(bench, grasp_templates(SPEC), 0.8, (0.0,), np.random.default_rng(0), region=parse_region("z>1"))
    with pytest.raises(ConfigError, match="nothing of its surface"):
        next(proposer.fresh())


@pytest.mark.slow
def test_the_share_of_the_force_in_a_region_and_beside_it_is_all_of_it() -> None:
    bench = TrialRunner(SPEC)
    case = load_case({"scenario": "tomato_soup_can", "protocol": "quick"}, SPEC)
    shares = [
        next(bench.verdicts([case], parse_region(text).share)).measured["region"] for text in ("x>0.0", "x<0.0", "z>-1")
    ]
    assert shares[0] + shares[1] == pytest.approx(1.0)
    assert 0.1 < shares[0] < 0.9
    assert shares[2] == 1.0


def test_a_part_of_an_object_turns_with_it() -> None:
    """A mug that is held from the side of its y alone; turned by a quarter, that is where its x points."""
    bench, case = TrialRunner(SPEC), load_case({"scenario": "mug", "protocol": "quick"}, SPEC)
    (mug,) = case.scenario.objects
    turned = case.scenario.model_copy(update={"objects": (mug.model_copy(update={"yaw": mug.yaw + 90.0}),)})
    for scene, text in ((case.scenario, "y>0"), (turned, "x>0")):
        (verdict,) = bench.verdicts([replace(case, scenario=scene)], parse_region(text).share)
        assert verdict.measured["region"] == 1.0


def test_whoever_waits_for_proposals_can_look_at_the_clock_after_every_batch() -> None:
    scenario = scenario_of("tomato_soup_can", "z", None, None, 0.8)
    bench = GraspScene(SPEC, make_stage(scenario, load_protocol("table_pick"), "right", Path()))
    proposer = Proposer(bench, grasp_templates(SPEC), 0.8, (0.0,), np.random.default_rng(0))
    assert list(proposer.fresh(tries=3 * BATCH)).count(None) == 3


@pytest.mark.slow
def test_in_the_air_an_object_is_held_by_its_part_too(in_the_air: tuple[GraspSearch, PlannedGrasp]) -> None:
    """What holds the pushes, but elsewhere, is not returned."""
    search, planned = in_the_air
    scenario = search.scenario
    inside, outside = parse_region("z>-1"), parse_region("z>1")
    bench = GraspScene(SPEC, make_stage(scenario, load_protocol("fc"), "right", Path()))
    for by, kept in ((inside, 1), (outside, 0)):
        prover = GraspValidator(
            bench, scenario, SPEC, search.templates, Path(), 0, Uncertainty(), object_symmetry(bench.placed), by
        )
        validate_in_air(prover, [planned.candidate])
        assert len(prover.best(5)) == kept


def test_what_a_push_takes_away_is_not_returned() -> None:
    """A hand that stays open."""
    scenario = scenario_of("tennis_ball", "z", None, None, 0.8).model_copy(update={"protocol": "fc"})
    bench, known = GraspScene(SPEC, make_stage(scenario, load_protocol("fc"), "right", Path())), grasp_templates(SPEC)
    opened = next(filter(None, Proposer(bench, known, 0.8, (0.0,), np.random.default_rng(0)).fresh()))
    opened = replace(opened, close=opened.preshape, squeeze=opened.preshape)
    prover = GraspValidator(bench, scenario, SPEC, known, Path(), 0, Uncertainty(), object_symmetry(bench.placed))
    validate_in_air(prover, [opened])
    assert prover.best(5) == []
    assert prover.ends == {"pushed out": 1, "held": 0}


def test_draws_in_which_a_joint_moved_too_fast_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Physics may have shaken the hand: such a no is not the grasp's."""
    scenario = scenario_of("tennis_ball", "z", None, None, 0.8)
    bench, known = (
        GraspScene(SPEC, make_stage(scenario, load_protocol("quick"), "right", Path())),
        grasp_templates(SPEC),
    )
    prover = GraspValidator(bench, scenario, SPEC, known, Path(), 0, Uncertainty(), object_symmetry(bench.placed))
    ends = [Verdict(None, why, too_fast=why == "fast") for why in ("", "fast", "index_1 is at 80 °C", "diverged")]
    monkeypatch.setattr(TrialRunner, "verdicts", lambda *_, **__: iter(ends))
    (option,) = [PlannedGrasp(None, scenario, known[0])]  # type: ignore[arg-type]
    prover._draw([option], 4)
    assert (option.tried, prover.drawn["draws"], prover.drawn["too fast"]) == (4, 4, 1)
