"""An object goes in, grasps that hold come out, as files that run."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, count, repeat
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.batch.trials import TrialCase, TrialRunner, load_case
from allegro_twin.grasping.evaluation.outcomes import make_rate
from allegro_twin.grasping.plan.candidate import Candidate, ObjectSymmetry, limit_squeeze
from allegro_twin.grasping.plan.draft import first_guess
from allegro_twin.grasping.plan.improve import GraspImprovement, GraspVariant, perturb_grasp
from allegro_twin.grasping.plan.save import describe, save_grasps, store_grasp
from allegro_twin.grasping.plan.search import (
    IN_HAND,
    LEAST,
    GraspSearch,
    RoundSize,
    SearchBudget,
    _Clock,
    _next,
    _Rounds,
)
from allegro_twin.grasping.plan.templates import grasp_templates
from allegro_twin.grasping.plan.validate import (
    CHOSEN,
    JUDGED,
    SEARCHED,
    SURE,
    GraspValidator,
    PlannedGrasp,
    best_grasps,
    judge_planned,
)
from allegro_twin.grasping.scenario import load_protocol, load_scenario
from allegro_twin.grasping.statistics import wilson
from allegro_twin.grasping.timeline import make_stage
from allegro_twin.grasping.uncertainty import sample_perturbations
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import GraspFile
from allegro_twin.hands.library.entry_files import read_file
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import Library, load_grasp
from allegro_twin.kinematics.orientation import matrix_facing
from allegro_twin.sim.contact.grasp_scene import GraspScene
from allegro_twin.surfaces.cli.grasps.plan import scenario_of
from benchmarks.planning import known_things

SPEC = load_spec()
LEMON = GraspVariant(load_scenario("lemon")[0], load_grasp("tripod_lemon", SPEC))
LITTLE = RoundSize(guessed=24, closed=8, drawn=3)
TINY = RoundSize(guessed=8, closed=4, drawn=1)
SEED = 3
"""Of those below ten one whose first round finds a grasp that is good."""


@pytest.fixture(scope="module")
def found() -> tuple[GraspSearch, list[PlannedGrasp], int]:
    """And in how many rounds."""
    search = GraspSearch(
        scenario_of("tennis_ball", "z", None, None, 0.8), SPEC, grasp_templates(SPEC), seed=SEED, effort=LITTLE
    )
    rounds: list[int] = []
    return search, search.run(1, SearchBudget(48), lambda best, at: rounds.append(len(best))), len(rounds)


@pytest.mark.slow
def test_a_ball_is_held_by_what_a_short_search_finds(found: tuple[GraspSearch, list[PlannedGrasp], int]) -> None:
    search, (planned,), _ = found
    assert planned.margin > 0.0
    assert planned.tried >= CHOSEN
    assert planned.expected == (planned.held + 1) / (planned.tried + 2)
    assert search.ends["held"] >= 1
    closed = sum(search.ends[name] for name in search.ends if name not in ("held", "whole trial"))
    assert closed == search.closed, "each candidate has one end"


@pytest.mark.slow
def test_what_was_written_is_what_was_proven(
    found: tuple[GraspSearch, list[PlannedGrasp], int], tmp_path: Path
) -> None:
    """The same trial from its files gives the same margin, to the last digit."""
    _, (planned,), _ = found
    (path,) = save_grasps([planned], "ball", tmp_path, SPEC)
    assert path == tmp_path / "ball_1.yaml"
    (verdict,) = TrialRunner(SPEC).verdicts([load_case({"scenario": path}, SPEC)])
    assert verdict.report is not None
    assert verdict.report.margin == planned.margin
    text = path.read_text()
    assert "grasp: grasps/ball_1.yaml" in text
    assert "Planned for tennis_ball, from" in text


@pytest.mark.slow
def test_a_grasp_that_is_kept_is_there_by_name_for_either_hand(
    found: tuple[GraspSearch, list[PlannedGrasp], int], tmp_path: Path
) -> None:
    _, (planned,), _ = found
    store_grasp(planned.grasp, "ball_1", tmp_path / "ball_1.yaml", SPEC, describe(planned, SPEC), evidence="ball_1")
    library, left = Library(tmp_path), load_spec(side="left")
    np.testing.assert_array_equal(library.grasp("ball_1", SPEC).squeeze, planned.grasp.squeeze)
    np.testing.assert_array_equal(library.grasp("ball_1", left).squeeze, SPEC.mirror_posture(planned.grasp.squeeze))


def grasp_beside(scenario: Path) -> GraspFile:
    """The entry in the file that was written with a scenario."""
    (listed,) = read_file(scenario.parent / "grasps" / scenario.name)
    assert isinstance(listed.entry, GraspFile)
    return listed.entry


def files(planned: list[PlannedGrasp], folder: Path) -> dict[str, bytes]:
    """What is written of them, judged on few draws."""
    judge_planned(planned, SPEC, SEARCHED, SEED, Path(), count=2)
    save_grasps(planned, "ball", folder, SPEC)
    return {path.name: path.read_bytes() for path in sorted(folder.rglob("*.yaml"))}


@pytest.mark.slow
def test_the_same_seed_and_as_many_candidates_write_the_same_files_bit_for_bit(
    found: tuple[GraspSearch, list[PlannedGrasp], int], tmp_path: Path
) -> None:
    """Here the first search ended because it had enough."""
    search, first, _ = found
    again = GraspSearch(search.scenario, SPEC, search.templates, seed=SEED, effort=LITTLE)
    second = again.run(1, SearchBudget(search.closed))
    assert again.closed == search.closed == first[0].candidates
    assert files(first, tmp_path / "first") == files(second, tmp_path / "second")


@pytest.mark.slow
def test_a_search_that_ran_out_of_time_within_a_round_is_repeated_by_its_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That round counts for nothing."""
    timed, counted = (
        GraspSearch(scenario_of("tennis_ball", "z", None, None, 0.8), SPEC, grasp_templates(SPEC), seed=0, effort=TINY)
        for _ in range(2)
    )
    readings = chain([0.0], repeat(1e9))  # Time is up after the first look in the second round.
    ended: list[float] = []
    monkeypatch.setattr(time, "process_time", lambda: next(readings) if ended else 0.0)
    found = timed.run(2, SearchBudget(cpu=100.0), lambda best, share: ended.append(share))
    monkeypatch.undo()
    assert (timed.closed, timed.cut, len(ended)) == (TINY.closed // 2, False, 1), "half, where forces are reckoned"
    again = counted.run(2, SearchBudget(timed.closed))
    assert counted.closed == timed.closed
    assert counted.ends == timed.ends
    assert all(each.tried >= CHOSEN for each in found), "nobody is chosen for two draws that it was lucky in"
    assert files(found, tmp_path / "timed") == files(again, tmp_path / "counted")


@pytest.mark.slow
def test_a_smaller_last_round_is_repeated_by_its_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    size = RoundSize(guessed=8, closed=12, drawn=1)
    one, timed, counted = (
        GraspSearch(scenario_of("wood_block", "z", None, None, 0.8), SPEC, grasp_templates(SPEC), seed=0, effort=size)
        for _ in range(3)
    )
    looks = count()  # The clock goes on by a second whenever somebody looks at it.
    monkeypatch.setattr(time, "process_time", lambda: float(next(looks)))
    one.run(1, SearchBudget(6))
    found = timed.run(1, SearchBudget(cpu=2.8 * next(looks)))
    monkeypatch.undo()
    assert timed.closed % 6 >= LEAST, "a round is of six"
    again = counted.run(1, SearchBudget(timed.closed))
    assert (counted.closed, counted.ends) == (timed.closed, timed.ends)
    assert files(found, tmp_path / "timed") == files(again, tmp_path / "counted")


@pytest.mark.slow
def test_a_search_without_time_for_one_round_says_that_it_was_cut() -> None:
    search = GraspSearch(scenario_of("wood_block", "z", None, None, 0.8), SPEC, grasp_templates(SPEC), seed=0)
    search.run(1, SearchBudget(cpu=1e-9))
    assert search.cut
    assert 1 <= search.closed <= 5


@pytest.mark.slow
def test_a_first_round_whose_time_ends_between_two_rungs_of_draws_says_that_it_was_cut(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    search = GraspSearch(
        scenario_of("tennis_ball", "z", None, None, 0.8), SPEC, grasp_templates(SPEC), seed=SEED, effort=TINY
    )
    rungs: list[int] = []
    draw = GraspValidator._draw

    def drawn(own: GraspValidator, options: Sequence[PlannedGrasp], count: int) -> None:
        draw(own, options, count)
        rungs.append(count)

    monkeypatch.setattr(time, "process_time", lambda: 1e9 if rungs else 0.0)
    monkeypatch.setattr(GraspValidator, "_draw", drawn)
    search.run(2, SearchBudget(cpu=100.0))
    assert search.cut


@pytest.mark.slow
def test_a_round_that_closes_one_candidate_ends_with_its_budget() -> None:
    search = GraspSearch(
        scenario_of("wood_block", "z", None, None, 0.8), SPEC, grasp_templates(SPEC), seed=0, effort=RoundSize(4, 1, 1)
    )
    search.run(5, SearchBudget(7))
    assert search.closed == 7


@pytest.mark.slow
def test_a_budget_of_candidates_is_kept_to_the_last_one() -> None:
    search = GraspSearch(
        scenario_of("tennis_ball", "z", None, None, 0.8), SPEC, grasp_templates(SPEC), seed=0, effort=TINY
    )
    search.run(5, SearchBudget(3))
    assert search.closed == 3


def test_the_last_round_is_as_large_as_the_time_that_is_left() -> None:
    clock = _Clock(100.0, time.process_time() - 40.0)
    assert clock.part(200.0, 10.0) == pytest.approx(0.5 * 50.0 / 200.0, abs=0.01)
    assert clock.part(10.0, 10.0) == 1.0
    assert clock.part(10.0, 70.0) < 0.0
    assert _Clock(math.inf, 0.0).part(10.0, 0.0) == 1.0


@pytest.mark.slow
def test_what_is_written_was_judged_after_it_was_chosen_on_draws_of_its_own(
    found: tuple[GraspSearch, list[PlannedGrasp], int], tmp_path: Path
) -> None:
    """In the whole trial, with the interval; they are none of those that it was chosen on, nor of those that
    `evaluate --uncertainty` makes of any seed."""
    search, (planned,), _ = found
    few = 3
    judge_planned([planned], SPEC, search.uncertainty, SEED, Path(), count=few)
    assert JUDGED >= 20
    drawn = sample_perturbations(search.uncertainty, few, SEED, stream="judge")
    cases = [TrialCase(planned.scenario, planned.grasp, draw) for draw in drawn]
    held = sum(verdict.held for verdict in TrialRunner(SPEC).verdicts(cases))
    assert (planned.judged, planned.judged_held) == (few, held)
    (path,) = save_grasps([planned], "ball", tmp_path, SPEC, search.uncertainty)
    proof = grasp_beside(path).planned
    assert proof is not None
    low, high = wilson(held, few)
    assert (proof.held, proof.draws, proof.protocol) == (held, few, "table_pick 2")
    assert (proof.low, proof.high) == (round(low, 4), round(high, 4))
    assert (proof.seed, proof.candidates) == (SEED, search.closed)
    assert f"held in {make_rate('', held, few)} draws that it was not chosen on" in path.read_text()
    assert not set(drawn) & {draw for seed in range(6) for draw in sample_perturbations(search.uncertainty, 50, seed)}


@pytest.mark.slow
def test_what_is_written_claims_the_type_that_its_contacts_show(
    found: tuple[GraspSearch, list[PlannedGrasp], int], tmp_path: Path
) -> None:
    """And not that of the grasp that it began as."""
    _, (planned,), _ = found
    (path,) = save_grasps([planned], "ball", tmp_path, SPEC)
    (verdict,) = TrialRunner(SPEC).verdicts([load_case({"scenario": path}, SPEC)])
    assert verdict.report is not None
    store_grasp = grasp_beside(path)
    assert store_grasp.observed == verdict.report.observed
    assert store_grasp.observed is not None
    assert (store_grasp.taxonomy.number, store_grasp.taxonomy.name) == (
        store_grasp.observed.number,
        store_grasp.observed.name,
    )


@pytest.mark.long
def test_a_search_for_a_type_keeps_nothing_of_another(found: tuple[GraspSearch, list[PlannedGrasp], int]) -> None:
    search, (planned,), _ = found
    shown = planned.grasp.observed
    assert shown is not None
    other = 23 if shown.number != 23 else 9
    wanted = GraspSearch(search.scenario, SPEC, search.templates, seed=SEED, effort=LITTLE, kind=other)
    assert wanted.run(1, SearchBudget(search.closed)) == []
    assert wanted.ends["other type"] >= 1


@pytest.mark.slow
def test_an_object_that_nothing_can_hold_says_where_candidates_ended() -> None:
    """A ball of lead: 12 kg."""
    scenario = scenario_of("tennis_ball", "z", None, None, 0.8)
    heavy = scenario.objects[0].model_copy(update={"shape": "sphere", "size": (0.0647,), "mass": 3.0})
    search = GraspSearch(scenario.model_copy(update={"objects": (heavy,)}), SPEC, grasp_templates(SPEC), effort=LITTLE)
    assert search.run(1, SearchBudget(8)) == []
    assert set(search.ends) <= {"empty", "unbalanced", "lift", "turn", "diverged"}


@pytest.mark.slow
def test_in_the_air_a_ball_is_held_against_pushes_along_every_axis(
    in_the_air: tuple[GraspSearch, PlannedGrasp],
) -> None:
    search, planned = in_the_air
    assert planned.margin > 0.0
    assert search.ends["held"] >= 1


def test_joints_that_are_eased_hold_with_a_share_of_their_limit_where_they_rest() -> None:
    """Others stay as they are."""
    gains, rest = load_gains("default", SPEC), LEMON.grasp.close
    reach = SPEC.actuation.torque_limit / gains.kp
    told = rest + reach * np.linspace(-2.0, 2.0, SPEC.n_joints)
    share = (limit_squeeze(replace(LEMON.grasp, squeeze=told), rest, gains, SPEC, 0.5).squeeze - rest) / reach
    wide = (SPEC.lower < told) & (told < SPEC.upper)
    assert wide.sum() > 10
    np.testing.assert_allclose(share[wide], np.clip(np.linspace(-2.0, 2.0, SPEC.n_joints), -0.5, 0.5)[wide], atol=2e-3)


def test_of_two_options_for_one_place_the_one_that_is_expected_to_hold_more_is_kept() -> None:
    """Fourteen of fourteen are better than two of two, for there is less doubt."""
    none, rest = np.zeros(3), np.zeros(SPEC.n_joints)
    candidate = Candidate(none, np.eye(3), none, rest, rest, rest, rest, rest, "tripod_lemon")
    elsewhere = replace(candidate, position=np.array([0.1, 0.0, 0.0]))
    sure, lucky, other = (
        PlannedGrasp(each, LEMON.scenario, LEMON.grasp, tried, tried)
        for each, tried in ((candidate, SURE), (candidate, 2), (elsewhere, 1))
    )
    assert best_grasps([lucky, other, sure], 5, ObjectSymmetry(np.zeros(3))) == [sure, other]
    assert sure.good
    assert not lucky.good
    assert not replace(sure, tried=8, held=8).good, "eight of eight are too few to say so"


@pytest.mark.long
def test_what_improves_is_no_worse_on_the_draws_that_it_was_chosen_on_and_is_compared_on_others() -> None:
    scenario, path = load_scenario("lemon")
    grasp = load_grasp(scenario.grasp, SPEC)
    told: list[float] = []
    search = GraspImprovement(scenario, grasp, SPEC, path.parent, rounds=2, population=2, draws=2, unseen=2)
    better = search.run(lambda number, share: told.append(share))
    assert told == sorted(told)
    assert better.comparison.draws == 2
    again = GraspImprovement(scenario, grasp, SPEC, path.parent, rounds=2, population=2, draws=2, unseen=2).run()
    np.testing.assert_array_equal(again.after.grasp.squeeze, better.after.grasp.squeeze)


@given(st.integers(0, 1000))
def test_a_variation_stays_inside_the_limits_and_near(seed: int) -> None:
    first, scenario = LEMON, LEMON.scenario
    other = perturb_grasp(first, SPEC, 1.0, np.random.default_rng(seed))
    for name in ("preshape", "close", "squeeze"):
        posture = getattr(other.grasp, name)
        assert (posture >= SPEC.lower).all()
        assert (posture <= SPEC.upper).all()
        assert np.abs(posture - getattr(first.grasp, name)).max() < 0.5
    moved = np.subtract(other.scenario.wrist.position, scenario.wrist.position)
    assert np.linalg.norm(moved) < 0.03


def test_a_first_guess_is_free_of_everything_until_its_fingers_close() -> None:
    scenario, grasp = first_guess(scenario_of("mug", "z", None, None, 0.8), SPEC)
    around = make_stage(scenario, load_protocol("table_pick"), "right", Path())
    bench = GraspScene(SPEC, around)
    rotation = matrix_facing(scenario.wrist.facing, scenario.wrist.fingers)
    position = around.position - np.array(scenario.wrist.retreat)
    bench.place(position, rotation, grasp.preshape)
    assert not bench.meets_anything()
    bench.place(position, rotation, grasp.close)
    assert bench.meets_anything()


def test_templates_of_a_type_without_closing_fingers_are_an_error() -> None:
    with pytest.raises(ConfigError):
        grasp_templates(SPEC, "no such type")


def test_where_no_guess_comes_a_search_ends_with_its_time_and_not_with_its_first_part() -> None:
    asked = list[None]()

    def never() -> Iterator[None]:
        while True:
            asked.append(None)
            yield None

    assert _next(never(), 3, lambda: True, lambda: len(asked) == 5) == []
    assert len(asked) == 5


@pytest.mark.parametrize(("cut", "most"), [(False, 0), (True, 3)])
def test_time_that_a_first_round_cut_short_has_left_goes_to_a_round_however_small(cut: bool, most: int) -> None:
    """16 of 40 s are spent, and a whole round of five candidates would take 16 more."""
    rounds: Any = object.__new__(_Rounds)
    rounds._search, rounds._n, rounds._full, rounds._longest = SimpleNamespace(closed=2, cut=cut), 1, 5, 16.0
    rounds._budget, rounds._prover = SearchBudget(cpu=40.0), SimpleNamespace(settling_time=lambda n: 0.0)
    rounds._clock = SimpleNamespace(part=lambda round_, settling: IN_HAND * (40.0 - 16.0 - settling) / round_)
    assert rounds._affordable() == most


def test_the_benchmark_of_planning_has_a_scenario_for_every_object_of_the_catalogue() -> None:
    things = known_things()
    assert len(things) == 22
    assert all(things[name].objects[0].name == name for name in things)
