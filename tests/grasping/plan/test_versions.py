"""Versions of a grasp are tried alike wherever that happens."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.errors import HandError
from allegro_twin.grasping.plan.improve import (
    GraspVariant,
    VariantResult,
    VariantWorkers,
    score,
    try_variants,
    variant_from_json,
    variant_to_json,
)
from allegro_twin.grasping.scenario import load_scenario
from allegro_twin.grasping.uncertainty import Uncertainty, sample_perturbations
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.spec import Side
from allegro_twin.sweep.local import Local

SPEC = load_spec()


def lemon() -> tuple[GraspVariant, Path]:
    scenario, path = load_scenario("lemon")
    return GraspVariant(scenario, load_grasp(scenario.grasp, SPEC)), path.parent


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_version_crosses_to_another_process_and_back_as_it_is(side: Side) -> None:
    spec = load_spec(side=side)
    scenario, _ = load_scenario("lemon")
    grasp = replace(load_grasp(scenario.grasp, spec), speed=0.7, profile="linear")
    again = variant_from_json(json.loads(json.dumps(variant_to_json(GraspVariant(scenario, grasp), spec))), spec)
    assert again.scenario == scenario
    assert (again.grasp.name, again.grasp.speed, again.grasp.profile) == (grasp.name, 0.7, "linear")
    for stage in ("preshape", "close", "squeeze"):
        np.testing.assert_array_equal(getattr(again.grasp, stage), getattr(grasp, stage))


def test_more_held_draws_count_more_than_anything_else_and_ease_decides_among_equals() -> None:
    hard, easy, lost = (
        VariantResult(True, 0.2, 1.0, 0.9),
        VariantResult(True, 0.2, 0.1, 0.5),
        VariantResult(False, 0.9, 0.0, 0.1),
    )
    assert score([hard, hard]) > score([easy, lost]) > score([hard, lost]) > score([lost, lost])
    assert score([easy]) > score([hard])
    assert score([VariantResult(True, 0.3, 1.0, 0.9)]) > score([hard])


@pytest.mark.long
def test_tries_are_the_same_in_this_process_and_in_two_others() -> None:
    version, folder = lemon()
    loose = GraspVariant(version.scenario, replace(version.grasp, squeeze=version.grasp.preshape))
    drawn = sample_perturbations(Uncertainty(), 2, 5, 0)
    here = try_variants([version, loose], SPEC, "quick", drawn, VariantWorkers(Local(0), 1, folder))
    assert here == try_variants([version, loose], SPEC, "quick", drawn, VariantWorkers(Local(2), 2, folder))
    assert [each.held for row in here for each in row] == [True, True, False, False]


def test_a_trial_that_cannot_be_made_is_one_error_and_not_a_grasp_that_fails() -> None:
    version, folder = lemon()
    lost = version.scenario.objects[0].model_copy(update={"name": "gone", "shape": "mesh", "file": "gone.stl"})
    gone = version.scenario.model_copy(update={"objects": (lost,)})
    with pytest.raises(HandError, match=r"gone\.stl"):
        try_variants(
            [GraspVariant(gone, version.grasp)],
            SPEC,
            "quick",
            sample_perturbations(Uncertainty(), 1, 0, 0),
            VariantWorkers(Local(0), 1, folder),
        )
