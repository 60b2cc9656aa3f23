"""Force-controlled grasps are not told what they grasp, and hold it all the same."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from allegro_twin.app import Rig, assemble, scenario_config
from allegro_twin.control.force_grasp import CentroidGrasp, pressing_forces
from allegro_twin.grasping.scenario import ScenarioObject, load_scenario
from allegro_twin.grasping.trial import Trial
from allegro_twin.grasping.verdict import TrialReport
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.loop import run, until
from allegro_twin.safety import Guard, Limits
from allegro_twin.sim.objects.catalogue import load_object
from allegro_twin.spec import Side
from allegro_twin.types import Array, Vector
from tests.grasping.test_trial import DEMO

FORCE = ["grasp_3", "grasp_4", "pinch_index", "pinch_middle"]
SIDES = ["right", pytest.param("left", marks=pytest.mark.long)]
"""Both in the long run; a trial of the left hand is the mirror image of the right hand's."""


def attempt(grasp: str, side: Side, thing: str | None = None, **changes: object) -> tuple[TrialReport, Trial]:
    """The trial of a force grasp with an object of the catalogue, or with a changed one."""
    rig = assemble(scenario_config(grasp, side, object_name=thing))
    assert rig.trial is not None
    trial, hand = rig.trial, rig.backend
    if changes:
        scenario, _ = load_scenario(grasp)
        own = ScenarioObject.model_validate({"name": "thing", **changes})
        trial = Trial(scenario.model_copy(update={"objects": (own,)}), rig.spec, trial.grasp)
        limit = np.full(rig.spec.n_joints, 12.0)
        hand = Guard(trial.backend, Limits(rig.spec.actuation.torque_limit, limit, rig.spec.lower, rig.spec.upper))
    for _ in trial.watched(until(trial.seconds, run(hand, rig.controller))):
        pass
    return trial.report(), trial


@cache
def tried(grasp: str, side: Side, thing: str) -> tuple[bool, float]:
    """Whether a centroid grasp held an object, and, from half a second after it was lifted until it is turned over,
    the thumb's force in the direction in which it was asked to press, over what it was asked for."""
    rig = assemble(scenario_config(grasp, side, object_name=thing))
    assert rig.trial is not None
    hold = next(window for window in rig.trial.windows if window.name == "hold")
    felt = []
    for sample in rig.trial.watched(until(rig.trial.seconds, run(rig.backend, rig.controller))):
        if hold.begin + 0.5 < sample.state.t <= hold.end:
            felt.append(thumb_force(rig, sample.state.position))
    return rig.trial.report().held, float(np.mean(felt))


def thumb_force(rig: Rig, position: Vector) -> float:
    controller, trial = rig.controller, rig.trial
    assert isinstance(controller, CentroidGrasp)
    assert trial is not None
    tips, _ = controller.fingertips(position)
    asked = pressing_forces(tips, controller.force, controller.spread)[-1]
    data = trial.backend.data
    # The sensor tells what presses the fingertip, in world axes.
    felt: Array = -data.sensor("thumb_touch").data[1:] @ data.body("palm_link").xmat.reshape(3, 3)
    return float(felt @ asked / (asked @ asked))


# Before each push one with an object, one with a ball of another size, grasp_3 with three sizes in
# examples/12_force_grasp.py; each of the four with all of it in the long run.
@pytest.mark.parametrize(
    "name", ["grasp_4", *(pytest.param(n, marks=pytest.mark.long) for n in FORCE if n != "grasp_4")]
)
@pytest.mark.parametrize("thing", ["lemon", pytest.param("tuna_fish_can", marks=pytest.mark.long)])
@pytest.mark.slow
def test_one_grasp_holds_a_small_and_a_wide_object(name: str, thing: str) -> None:
    report, _ = attempt(name, "right", thing)
    assert report.held, report.reason


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["pinch_index", *(pytest.param(n, marks=pytest.mark.long) for n in FORCE if n != "pinch_index")]
)
@pytest.mark.parametrize("difference", [-0.015, pytest.param(0.015, marks=pytest.mark.long)])
@pytest.mark.parametrize("side", SIDES)
def test_fifteen_millimetres_more_or_less_are_noticed_and_held(name: str, difference: float, side: Side) -> None:
    report, _ = attempt(name, side, shape="sphere", size=(0.0647 + difference,), mass=0.058)
    assert report.held, report.reason


@pytest.mark.long
@pytest.mark.parametrize("name", FORCE)
def test_each_force_grasp_holds_ten_of_the_twelve_demo_objects(name: str, side: Side) -> None:
    held = [thing for thing in DEMO if tried(name, side, thing)[0]]
    assert len(held) >= 10, held


@pytest.mark.long
@pytest.mark.parametrize("name", FORCE)
def test_the_thumb_presses_whatever_it_holds_within_a_fifth_of_what_was_asked_for(name: str, side: Side) -> None:
    """The fingers together press as much, or the object would not hang still."""
    share = {thing: tried(name, side, thing)[1] for thing in DEMO if tried(name, side, thing)[0]}
    assert share
    assert all(0.8 <= value <= 1.2 for value in share.values()), share


@pytest.mark.slow
def test_every_fingertip_presses_with_its_share_of_the_force_but_for_what_dry_friction_hides() -> None:
    """On a ball that weighs next to nothing, so that all that is felt is the grip."""
    name, wanted = "grasp_3", 2.5
    rig = assemble(scenario_config(name))
    scenario, _ = load_scenario(name)
    ball = ScenarioObject(name="thing", shape="sphere", size=(0.06,), mass=0.005)
    trial = Trial(scenario.model_copy(update={"objects": (ball,)}), rig.spec, load_grasp(name, rig.spec))
    controller = rig.controller
    assert isinstance(controller, CentroidGrasp)
    hold = next(window for window in trial.windows if window.name == "hold")
    felt = []
    for sample in trial.watched(until(hold.end, run(trial.backend, replace(controller, force=wanted)))):
        if sample.state.t > hold.begin + 0.5:
            touch = (trial.backend.data.sensor(f"{finger}_touch").data for finger in ("index", "middle", "thumb"))
            felt.append([float(np.linalg.norm(force[1:])) for force in touch])
            tips, _ = controller.fingertips(sample.state.position)
    share = np.linalg.norm(pressing_forces(tips, wanted, controller.spread), axis=1)
    hidden = float(rig.spec.actuation.frictionloss.max()) / 0.06  # N, at a fingertip's distance from its joints.
    np.testing.assert_allclose(np.mean(felt, axis=0), share, rtol=0.05, atol=hidden)


@pytest.mark.slow
@pytest.mark.parametrize("diameter", [0.100, *(pytest.param(d, marks=pytest.mark.long) for d in (0.060, 0.080))])
@pytest.mark.parametrize("side", SIDES)
def test_the_envelop_grasp_wraps_cans_of_any_diameter_from_their_side(diameter: float, side: Side) -> None:
    report, _ = attempt("envelop", side, shape="cylinder", size=(diameter, 0.082), mass=0.118)
    assert report.held, report.reason


def enveloped(thing: str) -> str:
    """The scenario in which `envelop` takes an object: what is round and stands higher than 80 mm from its side, all
    else from above."""
    own = load_object(thing)
    return "envelop" if own.shape == "cylinder" and own.size[1] > 0.080 else "envelop_above"


def test_most_of_the_demo_is_enveloped_from_above() -> None:
    assert [thing for thing in DEMO if enveloped(thing) == "envelop"] == ["mug", "tomato_soup_can"]


@pytest.mark.long
def test_the_envelop_grasp_holds_ten_of_the_twelve_demo_objects(side: Side) -> None:
    held = [thing for thing in DEMO if attempt(enveloped(thing), side, thing)[0].held]
    assert len(held) >= 10, held
