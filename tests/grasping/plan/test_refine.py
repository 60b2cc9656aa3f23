"""Evolution of candidates in geometry: they need less of the motors, stay different, and physics agrees."""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
import pytest

from allegro_twin.grasping.metrics.preload import GripForces, Preload
from allegro_twin.grasping.plan.candidate import Candidate, ObjectSymmetry, palm_distance
from allegro_twin.grasping.plan.close_in_simulation import FingerGains, close_candidates
from allegro_twin.grasping.plan.proposals.close_in_geometry import EXACT, meet_exactly, metric_contacts
from allegro_twin.grasping.plan.proposals.propose import (
    Proposer,
    could_hold,
    weight_loads,
    worst_case,
)
from allegro_twin.grasping.plan.proposals.refine import GENERATIONS, NICHE, Population
from allegro_twin.grasping.plan.search import GraspSearch
from allegro_twin.grasping.plan.templates import grasp_templates
from allegro_twin.grasping.scenario import load_protocol
from allegro_twin.hands import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.sim.contact.grasp_scene import TouchPoints
from allegro_twin.surfaces.cli.grasps.plan import scenario_of

SPEC = load_spec()
GAINS = load_gains("default", SPEC)
TURNS = (0.0, np.pi / 2.0, np.pi)
HERE = ObjectSymmetry(np.array([0.0, 0.0, 0.05]))


def proposer(thing: str, seed: int = 0) -> Proposer:
    search = GraspSearch(scenario_of(thing, "z", None, None, 0.8), SPEC, grasp_templates(SPEC))
    return search._proposer(load_protocol("table_pick"), np.random.default_rng(seed))


@pytest.fixture(scope="module")
def begun() -> tuple[Proposer, list[Candidate]]:
    """Proposals for the soup can."""
    known = proposer("tomato_soup_can")
    found = [each for each, _ in zip(filter(None, known.fresh()), range(24), strict=False)]
    return known, found


@pytest.fixture(scope="module")
def evolved(begun: tuple[Proposer, list[Candidate]]) -> Population:
    known, found = begun
    population = Population(known, HERE)
    population.evolve(found)
    return population


def share(candidate: Candidate) -> float:
    return -candidate.score


@pytest.mark.slow
def test_what_evolves_needs_less_of_its_motors(begun: tuple[Proposer, list[Candidate]], evolved: Population) -> None:
    before = np.median([share(each) for each in begun[1]])
    assert np.median([share(each) for each in evolved.elite]) < 0.5 * before


def test_a_part_of_a_round_has_that_part_of_its_generations(begun: tuple[Proposer, list[Candidate]]) -> None:
    population, looks = Population(begun[0], HERE, kept=2), count()
    assert population.evolve(begun[1][:1], lambda: next(looks) < 0, 2.5 / GENERATIONS)
    assert next(looks) == 3


@pytest.mark.slow
def test_no_more_than_a_few_of_what_evolves_are_alike(evolved: Population) -> None:
    for first in evolved.elite:
        near = [palm_distance(first, other, evolved.symmetry) for other in evolved.elite]
        alike = sum(far < 0.01 and turned < np.radians(10.0) for far, turned in near)  # Within half: of one leader.
        assert alike <= 3 * NICHE


@pytest.mark.slow
def test_what_geometry_reckons_is_what_physics_finds(evolved: Population) -> None:
    """Shares of the motors before and after physics has closed the fingers, where it finds as many contacts. And most
    hold the object through a lift and a turn: contacts that are lost when fingers rest come back as they squeeze."""
    known = evolved.proposer
    performer = FingerGains(GAINS, hand_kinematics(SPEC).gravity_torque)
    some = evolved.take(12)
    seen: list[Preload] = []
    counts: list[int] = []

    def noted(candidate: Candidate, touch: TouchPoints, data: Any) -> Preload:
        held = worst_case(known.bench, candidate, touch, 0.8, TURNS, GAINS, data).preload()
        seen.append(held)
        counts.append(len(touch.points))
        return held

    ends = close_candidates(known.bench, some, performer, 0.8, known.random, noted)
    closed = [(before, end) for before, end in zip(some, ends, strict=True) if end.where != "empty"]
    apart = []
    for held, many, (before, _) in zip(seen, counts, closed, strict=True):
        expected, contacts = _squeeze(known, before)
        if contacts == many:
            apart.append(abs(held.share - expected.share))
    assert len(apart) >= 2
    assert np.median(apart) < 0.1
    assert sum(each.passed for each in ends) >= 8
    limit = SPEC.actuation.torque_limit
    for held, (_, end) in zip(seen, closed, strict=True):
        if np.isfinite(held.share):  # What is squeezed with is for the contacts that there are, and firm.
            wanted = held.torque * max(1.0, 0.4 / (np.abs(held.torque) / limit).max())
            assert end.candidate.torque is not None
            np.testing.assert_allclose(end.candidate.torque, wanted)


def _squeeze(known: Proposer, candidate: Candidate) -> tuple[Preload, int]:
    """In geometry, and of how many contacts."""
    met, touch = meet_exactly(known.bench, candidate)
    return worst_case(known.bench, met, touch, 0.8, TURNS, GAINS).preload(), len(touch.points)


@pytest.mark.slow
def test_what_is_light_is_squeezed_with_two_fifths_of_the_motor_that_bears_most(evolved: Population) -> None:
    known, limit = evolved.proposer, SPEC.actuation.torque_limit
    faint = Preload(0.05, 0.05 * limit * np.sign(np.arange(16) - 7.5), np.zeros((3, 3)))
    performer = FingerGains(GAINS, hand_kinematics(SPEC).gravity_torque)
    ends = close_candidates(known.bench, evolved.elite[:2], performer, 0.8, known.random, lambda *_: faint)
    for end in ends:
        np.testing.assert_allclose(end.candidate.torque, 8.0 * faint.torque)  # type: ignore[arg-type]


@pytest.mark.slow
def test_physics_closes_no_candidate_for_a_second_time_and_the_population_begins_anew_when_none_is_left(
    begun: tuple[Proposer, list[Candidate]],
) -> None:
    population = Population(begun[0], HERE, elite=list(begun[1][:9]))
    rounds = [population.take(4) for _ in range(4)]
    assert [len(each) for each in rounds] == [4, 4, 1, 0]
    assert len({each for taken in rounds for each in taken}) == 9
    assert population.elite == []


def test_what_is_dropped_leaves_its_place_to_others(begun: tuple[Proposer, list[Candidate]]) -> None:
    first, second, third = begun[1][:3]
    population = Population(begun[0], HERE, elite=[first, second, third])
    population.drop([second])
    assert population.elite == [first, third]


def test_a_squeeze_is_reckoned_for_three_quarters_of_the_friction_and_a_fifth_more_weight_and_for_the_shake(
    begun: tuple[Proposer, list[Candidate]],
) -> None:
    known, (candidate, *_) = begun
    (grown,) = known.grow([candidate])
    met, touch = meet_exactly(known.bench, grown)
    found = worst_case(known.bench, met, touch, 0.8, TURNS, GAINS)
    loads = weight_loads(met.rotation, 1.2 * 0.349, TURNS) * [[1.0], [1.15], [1.3]]
    contacts, limit = metric_contacts(touch, known.centre, 0.6), SPEC.actuation.torque_limit
    forces = GripForces(contacts, known.bench.jacobians(touch), limit)
    expected, least = forces.least_preload(GAINS.kp, loads), forces.limit_share(loads)
    assert found.preload().share == pytest.approx(expected.share, rel=1e-6)
    assert found.limit_share() == pytest.approx(least, rel=1e-6)
    assert grown.score == pytest.approx(-0.8 * least - 0.2 * expected.share, rel=1e-3)


def test_fingers_meet_the_object_within_a_step_that_is_an_eighth_of_the_coarse_one(
    begun: tuple[Proposer, list[Candidate]],
) -> None:
    known, (candidate, *_) = begun
    met, touch = meet_exactly(known.bench, candidate)
    assert could_hold(known.bench, touch, known.centre, 0.8)
    back = met.close - 2.0 * EXACT * met.closing
    moving = met.closing != 0.0
    free = replace(met, close=np.where(moving, back, met.close))
    known.bench.place(free.position, free.rotation, free.close)
    assert len(known.bench.touch().points) < len(touch.points)
    assert touch.depth.max() < 0.08 * EXACT + 0.002, "a fingertip 80 mm from its joint, and half a touch"
