"""A squeeze is made smaller until no joint sustains more than was asked, and what falls then is said to fall."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.control.controllers import Gains
from allegro_twin.errors import ConfigError
from allegro_twin.grasping.batch.batched_trials import Verdict
from allegro_twin.grasping.batch.trials import TrialCase, TrialRunner
from allegro_twin.grasping.plan import improve
from allegro_twin.grasping.plan.ease import TRIALS, ease_squeeze
from allegro_twin.grasping.plan.improve import GraspImprovement, GraspVariant, VariantResult, score
from allegro_twin.grasping.scenario import load_scenario
from allegro_twin.grasping.verdict import TrialReport
from allegro_twin.hands import load_spec
from allegro_twin.hands.library.entries import LatchGrip
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.types import Vector

SPEC = load_spec()
LIMIT = SPEC.actuation.torque_limit
SCENARIO, _ = load_scenario("lemon")
GRASP = load_grasp(SCENARIO.grasp, SPEC)


@dataclass
class Fingers:
    """A trial runner whose joints stop where the grasp closes, and give way by a part of their squeeze."""

    least: float = 0.0
    """Share of its limit by the hottest joint below which the object falls."""
    yields: float = 0.1
    spec: Any = SPEC
    gains: Gains = field(default_factory=lambda: load_gains("default", SPEC))
    tried: list[Grasp] = field(default_factory=list)

    def rest(self, grasp: Grasp) -> Vector:
        return grasp.close + self.yields * (grasp.squeeze - grasp.close)

    def gives(self, grasp: Grasp) -> Vector:
        return np.minimum(np.abs(self.gains.kp * (grasp.squeeze - self.rest(grasp))) / LIMIT, 1.0)

    def verdicts(self, cases: Sequence[TrialCase], measure: Any = None) -> Iterator[Verdict]:
        for case in cases:
            self.tried.append(case.grasp)
            sustained = dict(zip(SPEC.joints, self.gives(case.grasp).tolist(), strict=True))
            held = max(sustained.values()) >= self.least
            report = TrialReport(held, "", (), 1.0, 0.15, 0.0, sustained, sustained)
            yield Verdict(report, measured=dict(zip(SPEC.joints, self.rest(case.grasp).tolist(), strict=True)))


def eased(fingers: Fingers, share: float, grasp: Grasp = GRASP) -> Any:
    return ease_squeeze(SCENARIO, grasp, fingers, share, Path())  # type: ignore[arg-type]


HARD = replace(GRASP, squeeze=np.clip(GRASP.close + 5.0 * (GRASP.squeeze - GRASP.close), SPEC.lower, SPEC.upper))


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_no_joint_sustains_more_than_was_asked_and_the_hottest_nearly_that(share: float) -> None:
    found = eased(Fingers(), share, HARD)
    assert found.within(share)
    assert 0.8 * share < found.sustained <= share
    assert Fingers().gives(found.grasp).max() == pytest.approx(found.sustained)


def test_a_squeeze_that_is_small_enough_is_left_as_it_is() -> None:
    fingers = Fingers()
    assert eased(fingers, 1.0).grasp is GRASP
    assert len(fingers.tried) == 1


def test_where_the_object_falls_with_less_it_is_not_within_though_the_last_squeeze_is_small() -> None:
    found = eased(Fingers(least=0.55), 0.5, HARD)
    assert not found.within(0.5)
    assert not found.within(1.0)
    assert math.isnan(found.sustained)


def test_a_joint_that_the_others_push_is_not_within_however_often_it_is_tried() -> None:
    class Pushed(Fingers):
        def gives(self, grasp: Grasp) -> Vector:
            return np.full(SPEC.n_joints, 0.8)

    fingers = Pushed()
    found = eased(fingers, 0.6, HARD)
    assert len(fingers.tried) == TRIALS
    assert found.verdict.held
    assert not found.within(0.6)


def test_a_grasp_that_latches_is_eased_from_where_it_closes() -> None:
    """It gives what its squeeze is beyond its close, wherever the object stops it."""

    class Latching(Fingers):
        def rest(self, grasp: Grasp) -> Vector:
            return grasp.close + 0.1

        def gives(self, grasp: Grasp) -> Vector:
            return np.minimum(np.abs(self.gains.kp * (grasp.squeeze - grasp.close)) / LIMIT, 1.0)

    latching = replace(HARD, grip=LatchGrip(kind="latch"))
    found = eased(Latching(), 0.5, latching)
    assert found.within(0.5)
    assert Latching().gives(found.grasp).max() > 0.3


def test_a_version_counts_only_where_no_joint_sustains_more_than_allowed() -> None:
    hot, cool = VariantResult(True, 0.9, 0.0, 0.7), VariantResult(True, 0.1, 0.0, 0.6)
    assert score([cool, cool], 0.6) > score([hot, cool], 0.6) > score([hot, hot], 0.6)
    assert score([hot, hot]) > score([cool, cool])


@pytest.fixture
def search(monkeypatch: pytest.MonkeyPatch) -> GraspImprovement:
    """Nothing is searched, and what holds is told by how hot it is."""
    monkeypatch.setattr(improve, "TrialRunner", lambda spec: Fingers(least=0.55))
    monkeypatch.setattr(
        GraspImprovement, "_tried", lambda self, versions, protocol, count, stream: [[
            VariantResult(True, 0.5, 0.0, float(Fingers().gives(version.grasp).max()))] * count for version in versions]
    )  # fmt: skip
    return GraspImprovement(SCENARIO, HARD, SPEC, rounds=0, unseen=7)


def test_improvement_without_rounds_only_eases_and_says_what_is_sustained(search: GraspImprovement) -> None:
    search.sustained = 0.6
    found = search.run()
    (_, hot), (_, cool) = found.hottest
    assert hot == pytest.approx(1.0)
    assert 0.55 <= cool <= 0.6
    assert found.comparison.both == 7


def test_where_nothing_holds_so_cool_improvement_says_so(search: GraspImprovement) -> None:
    search.sustained = 0.5
    with pytest.raises(ConfigError, match="no version holds lemon with at most 50% of every joint's torque limit"):
        search.run()


def test_variations_are_of_what_was_eased(search: GraspImprovement, monkeypatch: pytest.MonkeyPatch) -> None:
    varied: list[Grasp] = []

    def vary(version: GraspVariant, *_: Any) -> GraspVariant:
        varied.append(version.grasp)
        return version

    monkeypatch.setattr(improve, "perturb_grasp", vary)
    monkeypatch.setattr(GraspImprovement, "_eased", lambda self, versions: [])
    search.sustained, search.rounds, search.population = 0.6, 1, 2
    search.run()
    assert len(varied) == 2
    assert all(Fingers().gives(grasp).max() <= 0.6 for grasp in varied)


def test_without_a_bound_nothing_is_eased(search: GraspImprovement) -> None:
    np.testing.assert_array_equal(search.run().after.grasp.squeeze, HARD.squeeze)


@pytest.mark.slow
def test_a_lemon_is_held_with_half_of_the_motors() -> None:
    runner = TrialRunner(SPEC, threads=1)
    found = ease_squeeze(SCENARIO, GRASP, runner, 0.5, Path())
    assert found.within(0.5)
    (again,) = runner.verdicts([TrialCase(SCENARIO, found.grasp)])
    assert again.report is not None
    assert again.held
    assert again.report.hottest[1] <= 0.5


def test_the_improved_grasp_is_a_version_of_its_own(search: GraspImprovement) -> None:
    search.sustained = 0.6
    found = search.run()
    assert isinstance(found.after, GraspVariant)
    assert found.before.grasp is HARD
