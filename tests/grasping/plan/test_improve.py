"""A search for a better grasp keeps the best, looks ever nearer, and compares on draws that it never looked at."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from allegro_twin.grasping.plan import improve
from allegro_twin.grasping.plan.improve import GraspImprovement, GraspVariant, VariantResult, perturb_grasp
from allegro_twin.grasping.plan.proposals.poses import closing_directions
from allegro_twin.grasping.scenario import load_scenario
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_grasp

SPEC = load_spec()


def lemon() -> GraspVariant:
    scenario, _ = load_scenario("lemon")
    return GraspVariant(scenario, load_grasp(scenario.grasp, SPEC))


class Search:
    """An improvement whose tries cost nothing: a version is as good as its squeeze's first joint."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **settings: Any) -> None:
        first = lemon()
        self.search = GraspImprovement(first.scenario, first.grasp, SPEC, **settings)
        self.asked: list[tuple[int, str, int, str]] = []
        self.scales: list[float] = []
        self.parents: list[list[float]] = []
        self.eased: list[int] = []
        self.number = 0
        monkeypatch.setattr(improve, "check_stiffness", lambda spec: None)
        monkeypatch.setattr(improve, "perturb_grasp", self.vary)
        monkeypatch.setattr(GraspImprovement, "_eased", lambda search, versions: self.counted(versions))
        monkeypatch.setattr(GraspImprovement, "_seen", lambda search, version: (version, ("", 0.5)))
        monkeypatch.setattr(GraspImprovement, "_tried", self.tried)

    def made(self, worth: float) -> GraspVariant:
        first = lemon()
        return GraspVariant(first.scenario, replace(first.grasp, speed=worth))

    def vary(self, version: GraspVariant, spec: Any, scale: float, random: Any) -> GraspVariant:
        self.scales.append(scale)
        self.number += 1
        return self.made(version.grasp.speed + (0.01 if self.number % 2 else -0.01) * scale)

    def counted(self, versions: list[GraspVariant]) -> list[GraspVariant]:
        self.eased.append(len(versions))
        return []

    def tried(self, versions: list[GraspVariant], protocol: str, count: int, stream: str) -> list[list[VariantResult]]:
        self.asked.append((len(versions), protocol, count, stream))
        self.parents.append([version.grasp.speed for version in versions])
        return [[VariantResult(True, version.grasp.speed / 10.0, 0.0, 0.5)] * count for version in versions]


def test_each_round_varies_the_four_best_a_little_less_and_the_end_is_on_draws_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    search = Search(monkeypatch)
    told: list[tuple[int, float]] = []
    better = search.search.run(lambda number, share: told.append((number, share)))
    # Three rounds of sixteen, unless somebody says otherwise, after the first alone; and forty draws in the end.
    assert search.asked == [
        (1, "quick", 8, "search"),
        *[(16, "quick", 8, "search")] * 3,
        (5, "quick", 32, "search"),
        (2, "table_pick", 40, "judge"),
    ]
    assert search.scales == pytest.approx([1.0] * 16 + [0.7] * 16 + [0.49] * 16)
    assert search.eased == [1, 2, 2]
    first = lemon().grasp.speed
    assert better.after.grasp.speed == pytest.approx(first + 0.01 * (1.0 + 0.7 + 0.49))
    assert better.before.grasp.speed == first
    assert search.parents[-1] == pytest.approx([first, better.after.grasp.speed])
    assert (better.comparison.both, better.comparison.draws) == (40, 40)
    assert [number for number, _ in told] == [0, 1, 2]
    assert [share for _, share in told] == [1.0, 1.0, 1.0]
    # Sixteen children of four parents: four of each.
    assert len({round(worth, 9) for worth in search.parents[2]}) <= 8


def test_what_is_worse_than_the_first_does_not_take_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    search = Search(monkeypatch, rounds=2, population=3)
    monkeypatch.setattr(improve, "perturb_grasp", lambda version, spec, scale, random: search.made(0.01))
    better = search.search.run()
    assert better.after.grasp.speed == lemon().grasp.speed
    assert not better.found


def test_the_best_of_few_draws_is_told_from_a_lucky_one_by_more(monkeypatch: pytest.MonkeyPatch) -> None:
    search = Search(monkeypatch, rounds=1, population=4)

    def tried(own: Any, versions: list[GraspVariant], protocol: str, count: int, stream: str) -> Any:
        """Every variation holds the first eight draws, and none after them; the first version holds most."""
        first, lucky = [k % 8 < 7 for k in range(40)], [k < 8 for k in range(40)]
        rows = [first if version.grasp.speed == lemon().grasp.speed else lucky for version in versions]
        return [[VariantResult(held, 0.5, 0.0, 0.5) for held in row[:count]] for row in rows]

    monkeypatch.setattr(GraspImprovement, "_tried", tried)
    assert not search.search.run().found


def test_a_variation_looks_as_far_as_its_round_does() -> None:
    """Standard deviations of 4 mm, 4 degrees about each axis, 0.05 rad of the joints."""
    first, random = lemon(), np.random.default_rng(0)
    middle = (SPEC.lower + SPEC.upper) / 2
    grasp = replace(first.grasp, preshape=middle, close=middle, squeeze=middle)
    first = GraspVariant(first.scenario, grasp)
    for scale in (1.0, 0.5):
        made = [perturb_grasp(first, SPEC, scale, random) for _ in range(400)]
        moved = np.array([np.subtract(each.scenario.wrist.position, first.scenario.wrist.position) for each in made])
        assert moved.std() == pytest.approx(0.004 * scale, rel=0.06)
        facing = np.array([each.scenario.wrist.facing for each in made])
        begin = np.array(first.scenario.wrist.facing) / np.linalg.norm(first.scenario.wrist.facing)
        turned = np.arccos(np.clip(facing @ begin, -1.0, 1.0))
        assert np.sqrt(np.square(turned).mean()) == pytest.approx(np.radians(4.0) * scale * np.sqrt(2.0), rel=0.08)
        closed = np.array([each.grasp.close for each in made]) - middle
        assert closed.std() == pytest.approx(0.05 * scale, rel=0.03)
        opened = np.array([each.grasp.preshape for each in made]) - middle
        np.testing.assert_allclose(opened, closed, atol=1e-9)  # Both by the same.
        assert np.abs(np.array([each.grasp.squeeze for each in made]) - middle - closed).max() < 1e-9
        assert all(each.grasp.observed is None for each in made)


def test_a_variation_squeezes_more_or_less_and_only_the_joints_that_close_a_little_otherwise() -> None:
    first, random = lemon(), np.random.default_rng(1)
    told = first.grasp.squeeze - first.grasp.close
    closing = closing_directions(first.grasp, SPEC) != 0.0
    room = np.minimum(first.grasp.close - SPEC.lower, SPEC.upper - first.grasp.close) > 0.3
    made = [perturb_grasp(first, SPEC, 1.0, random).grasp for _ in range(600)]
    squeezes = np.array([each.squeeze - each.close for each in made])
    still = room & ~closing
    factor = np.exp(0.35**2 / 2.0)  # The mean of a lognormal factor.
    np.testing.assert_allclose(squeezes.mean(axis=0)[room], told[room] * factor, atol=6e-3)
    spread = np.sqrt(np.square(told) * factor**2 * (np.exp(0.35**2) - 1.0) + np.where(closing, 0.025**2, 0.0))
    np.testing.assert_allclose(squeezes.std(axis=0)[room], spread[room], rtol=0.12, atol=1e-4)
    assert room.sum() >= 6
    assert np.abs(squeezes[:, still & (told == 0.0)]).max(initial=0.0) < 1e-3
