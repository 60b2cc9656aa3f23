"""`plan` with other hands: the same search, which asks the spec what closes the fingers and by how much."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from allegro_twin.app.config import RunConfig
from allegro_twin.app.rig import assemble
from allegro_twin.errors import ConfigError
from allegro_twin.files.yaml_edit import write_settings
from allegro_twin.grasping.batch.trials import TrialCase, TrialRunner, hand_name, load_case
from allegro_twin.grasping.plan.candidate import check_efforts
from allegro_twin.grasping.plan.close_in_simulation import FingerGains, close_candidates
from allegro_twin.grasping.plan.improve import GraspImprovement
from allegro_twin.grasping.plan.parallel import run_searches
from allegro_twin.grasping.plan.proposals.close_in_geometry import FINE, close_fingers, motor_scale
from allegro_twin.grasping.plan.proposals.opposition import (
    OpposingGrasp,
    _Opposition,
    _Residuals,
    card_postures,
    opposing_grasps,
)
from allegro_twin.grasping.plan.proposals.poses import PoseGuesses, SurfaceSample, closing_directions, guess_poses
from allegro_twin.grasping.plan.proposals.propose import OVERLAP, Proposer, could_hold, fit_palm
from allegro_twin.grasping.plan.save import save_grasps
from allegro_twin.grasping.plan.search import GraspSearch, RoundSize, SearchBudget, search_symmetry
from allegro_twin.grasping.plan.templates import grasp_templates
from allegro_twin.grasping.plan.validate import AS_IT_IS, SEARCHED, GraspValidator, PlannedGrasp
from allegro_twin.grasping.scenario import load_protocol, load_scenario
from allegro_twin.grasping.timeline import make_stage
from allegro_twin.grasping.uncertainty import Perturbation, Uncertainty, sample_perturbations
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import load_grasp, load_posture
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.sim.contact.grasp_scene import GraspScene, TouchPoints
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.model.physics import Physics
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.cli.grasps.plan import scenario_of
from tests.conftest import MakeSim
from tests.hands.models import GRIPPER, HANDS, hand, made

LITTLE = RoundSize(guessed=24, closed=8, drawn=3)


def search_of(spec: HandSpec, thing: str = "tennis_ball", effort: RoundSize = LITTLE) -> GraspSearch:
    scenario = scenario_of(thing, "z", None, None, 0.8).model_copy(update={"hand": spec.model_reference})
    return GraspSearch(scenario, spec, grasp_templates(spec), effort=effort)


def bench_of(spec: HandSpec, thing: str = "tennis_ball") -> GraspScene:
    scenario = scenario_of(thing, "z", None, None, 0.8)
    return GraspScene(spec, make_stage(scenario, load_protocol("table_pick"), "right", Path()))


def named(*names: str) -> list[Any]:
    """Hands for a test; in the fast tier one of those whose motors turn a joint each, and one of those with tendons."""
    return [pytest.param(name, marks=() if name in ("allegro", "qb_softhand") else pytest.mark.slow) for name in names]


@cache
def opposed(name: str) -> tuple[OpposingGrasp, ...]:
    """What a hand opposes its thumb with, as if the library had no grasp of it; several tests look at it."""
    return tuple(opposing_grasps(load_spec(name)))


def test_a_step_is_as_far_as_the_fastest_joint_of_a_motor_turns() -> None:
    np.testing.assert_array_equal(motor_scale(load_spec("leap")), np.ones(16))
    thumb = 2.542  # rad of its first joint, of one closure.
    assert motor_scale(load_spec("qb_softhand"))[0] == pytest.approx(1.0 / thumb, rel=0.1)
    spread, *fingers = motor_scale(load_spec("model_o"))
    assert spread == pytest.approx(1.0, rel=0.05)
    np.testing.assert_allclose(fingers, 0.0065 / 0.0066, rtol=0.05)


def test_a_short_slide_is_closed_in_as_many_steps_as_a_joint(tmp_path: Path) -> None:
    assert motor_scale(hand("gripper", tmp_path))[0] == pytest.approx(0.05 / 1.6)


@pytest.mark.parametrize("name", ["model_o", "qb_softhand"])
def test_what_lies_beyond_a_link_that_has_met_the_ball_goes_on(name: str) -> None:
    """In the closed posture joints have stopped behind where their motor would have them, free; none is ahead."""
    spec = load_spec(name)
    bench, known = bench_of(spec), grasp_templates(spec)
    proposer = Proposer(bench, known, 0.8, (0.0,), np.random.default_rng(0), step=FINE)
    candidate = next(filter(None, proposer.fresh()))
    found, touch = close_fingers(bench, candidate, FINE)
    assert len(set(touch.part.tolist())) >= 2
    assert touch.depth.max() < 0.01
    behind = [
        free - float(bench.data.joint(each.name).qpos[0])
        for each, free in zip(spec.followers, spec.coupled_positions(found.close), strict=True)
        if found.closing[each.driven] and np.ptp(each.positions) > 0.5
    ]
    assert max(behind) > 0.1
    assert min(behind) > -1e-9
    assert (found.close >= candidate.preshape).all()


@pytest.mark.long
def test_a_model_o_finds_a_grasp_that_is_written_for_it_and_judged_the_same(tmp_path: Path) -> None:
    spec = load_spec("model_o")
    (planned,) = search_of(spec).run(1, SearchBudget(400))
    assert planned.margin > 0.0
    (path,) = save_grasps([planned], "ball", tmp_path, spec)
    assert load_scenario(path)[0].hand == "model_o"
    (verdict,) = TrialRunner(spec).verdicts([load_case({"scenario": path}, spec)])
    assert verdict.report is not None
    assert verdict.report.margin == planned.margin


@pytest.mark.long
@pytest.mark.parametrize("name", ["leap", "qb_softhand"])
def test_every_other_hand_finds_a_grasp_of_a_ball(name: str) -> None:
    spec = load_spec(name)
    (planned,) = search_of(spec, effort=RoundSize(guessed=96, closed=24, drawn=4)).run(1, SearchBudget(400))
    assert planned.margin > 0.0


def trial_in_a_draw(name: str, scenario: str, draw: Perturbation | None = None) -> tuple[TrialRunner, TrialCase]:
    spec = load_spec(name)
    case = load_case({"scenario": scenario, "protocol": "quick"}, spec)
    return TrialRunner(spec), replace(case, draw=draw)


def test_trials_of_a_search_take_steps_that_the_hand_bears() -> None:
    """Coarse protocols ask for 3 ms, and searches for 2."""
    for name, scenario, step, searched in (
        ("allegro", "lemon", 0.003, 0.002), ("qb_softhand", "qb_softhand_lemon", 0.0015, 0.0015)
    ):  # fmt: skip
        runner, case = trial_in_a_draw(name, scenario)
        assert runner.trial(case).backend.model.opt.timestep == step
        search = GraspSearch(case.scenario, runner.spec, grasp_templates(runner.spec))
        assert search._stages(load_protocol("table_pick"))[0].physics.timestep == searched
    soft = load_spec("qb_softhand")
    assert Physics(timestep=0.003).for_hand(soft, 0.002).timestep == 0.001
    assert Physics(timestep=0.003).for_hand(replace(soft, coarsest_step=0.0011), 0.003).timestep == 0.001
    assert Physics().for_hand(soft, 0.002) == Physics()
    assert Physics(timestep=0.0005).for_hand(soft, 0.003).timestep == 0.0005, "a shorter one stays"
    for count in range(1, 40):
        assert soft.longest_step(count * 0.0015) == pytest.approx(0.0015), "the last digit of a product makes no step"
    assert load_spec().longest_step(0.003) == 0.003


@pytest.mark.slow
def test_the_soft_hand_holds_in_draws_what_it_holds_in_the_whole_trial() -> None:
    """In steps of 3 ms its fingers shook in each of these draws, and no grasp of a mug was one."""
    draws = sample_perturbations(SEARCHED, 3, 0, stream="judge")
    runner, case = trial_in_a_draw("qb_softhand", "qb_softhand_mug")
    assert all(verdict.held for verdict in runner.verdicts([replace(case, draw=draw) for draw in draws]))


def test_a_step_that_a_hand_does_not_bear_is_refused_where_a_person_asks_for_it() -> None:
    scene = {"kind": "sim", "timestep": 0.002}
    chosen = RunConfig.model_validate(
        {"hand": {"model": "qb_softhand"}, "backend": {"kind": "qb", "port": "virtual", "scene": scene}, "period": 0.02,
         "controller": {"kind": "position"}, "task": {"posture": "home"}}
    )  # fmt: skip
    with pytest.raises(ConfigError, match=r"^timestep 0.002 s: qb_softhand_right is simulated truly in steps of at"):
        assemble(chosen)


def test_a_search_side_by_side_is_of_the_hand_that_it_was_asked_for() -> None:
    spec = load_spec("model_o")
    heavy = search_of(spec).scenario
    thing = heavy.objects[0].model_copy(update={"shape": "sphere", "size": (0.0647,), "mass": 3.0})
    shared = {
        "scenario": heavy.model_copy(update={"objects": (thing,)}).model_dump(mode="json"), "folder": ".",
        "hand": "model_o", "side": "right", "kind": None, "n": 1, "budget": {"candidates": 2},
        "effort": {"guessed": 4, "closed": 2, "drawn": 1}, "region": None, "twin": "",
        "uncertainty": SEARCHED.model_dump(mode="json"),
    }  # fmt: skip
    (row,) = run_searches(shared, [{"seed": 0}])
    assert row["found"] == "[]"
    with pytest.raises(ConfigError, match="no_such_hand"):
        run_searches(shared | {"hand": "no_such_hand"}, [{"seed": 0}])


def test_a_hand_without_a_grasp_in_the_library_begins_with_its_fingertips_opposite_each_other(tmp_path: Path) -> None:
    spec = hand("gripper", tmp_path)
    found = grasp_templates(spec)
    assert len(found) > 1
    for grasp in found:
        assert (grasp.preshape >= grasp.close).all()
        assert (grasp.close >= grasp.squeeze).all()
        assert (grasp.preshape > grasp.squeeze).all()
    loose = replace(spec, actuation=replace(spec.actuation, stiffness=None))
    with pytest.raises(ConfigError, match="gripper_right: its card says no `stiffness` of what is driven"):
        grasp_templates(loose)
    with pytest.raises(ConfigError, match="gripper_right has fewer than two fingertips: name them in its card"):
        opposing_grasps(replace(spec, fingers=spec.fingers[:1]))
    with pytest.raises(ConfigError, match="soft_right: no posture has its fingertips opposite each other"):
        opposing_grasps(hand("soft", tmp_path / "soft"))


@pytest.mark.parametrize("name", named("allegro", "leap", "qb_softhand", "sih", "model_o"))
def test_a_hand_opposes_its_thumb_with_all_fingers_with_two_and_with_one(name: str) -> None:
    """As if the library had no grasp of it: tips on the ball to 15 mm, inside the limits, the thumb among them."""
    spec = load_spec(name)
    for grasp in opposed(name):
        tips = hand_kinematics(spec).fingertips(grasp.close)
        away = np.linalg.norm([tips[name].position - grasp.centre for name in grasp.fingers], axis=1)
        assert grasp.name == "_".join([*grasp.fingers, f"{1000 * grasp.diameter:.0f}mm"])
        assert np.abs(away - grasp.diameter / 2).max() < 0.015
        assert (spec.lower <= grasp.preshape).all()
        assert (grasp.squeeze <= spec.upper).all()
        assert grasp.fingers[0] == "thumb"


@pytest.mark.parametrize("name", named("allegro", "leap", "qb_softhand", "sih"))
def test_fingertips_of_one_side_keep_their_order_and_their_distance(name: str) -> None:
    spec = load_spec(name)
    flat = {name: pose.position for name, pose in hand_kinematics(spec).fingertips(spec.rest).items()}
    for grasp in opposed(name):
        tips = hand_kinematics(spec).fingertips(grasp.close)
        for first, second in combinations(grasp.fingers[1:], 2):
            way = flat[first] - flat[second]
            far = float(np.linalg.norm(way))
            apart = (tips[first].position - tips[second].position) @ way / far
            assert apart > 0.6 * min(far, 0.025)


def test_the_slopes_of_the_least_squares_are_those_of_its_values_but_for_the_pads() -> None:
    """The pads are taken as if they kept their direction."""
    hand = _Opposition(load_spec())
    group = [3, 0, 1, 2]
    state, random = _Residuals(hand, group, 0.03), np.random.default_rng(0)
    x = np.append(random.uniform(hand.lower, hand.upper), random.normal(0.0, 0.05, 3))
    x[:16] = np.where(np.arange(16) % 4 == 0, 0.0, x[:16])  # Side by side and near each other: spaces count.
    slopes, step = state.slopes(x), 1e-6
    for column in range(len(x)):
        more, less = x.copy(), x.copy()
        more[column], less[column] = x[column] + step, x[column] - step
        found = (state.values(more) - state.values(less)) / (2.0 * step)
        rows = np.r_[0:7, 11 : len(found)]
        np.testing.assert_allclose(slopes[rows, column], found[rows], atol=1e-4)


@pytest.mark.parametrize(("names", "holds"), [(("f0", "f1", "f2"), True), (("index", "middle", "thumb"), False)])
def test_two_fingers_hold_between_them_unless_the_hand_has_a_thumb(names: tuple[str, ...], holds: bool) -> None:
    """Of a hand with a thumb it or the palm is among what touches: two fingers of one side would be scissors."""
    at, flat = np.array([[0.02, 0.0, 0.0], [-0.02, 0.0, 0.0]] * 3), np.array([[-1.0, 0, 0], [1.0, 0, 0]] * 3)
    at[:, 1:] = np.repeat([[0.0, 0.01], [0.01, -0.01], [-0.01, -0.01]], 2, axis=0)
    touch = TouchPoints(at, flat, np.array([0, 1] * 3), np.zeros(6), np.zeros(6, dtype=int))
    bench = SimpleNamespace(
        spec=SimpleNamespace(fingers=[SimpleNamespace(name=name) for name in names]),
        meets_table=lambda: False,
    )
    assert could_hold(bench, touch, np.zeros(3), 0.8) == holds  # type: ignore[arg-type]


def test_palms_are_drawn_so_that_what_they_look_at_is_on_the_near_side_of_the_ball() -> None:
    spec, random = load_spec("leap"), np.random.default_rng(0)
    (grasp, *_) = opposed("leap")
    grasp = replace(grasp, centre=np.array([0.5, 0.3, -0.2]))  # Far from where the library's grasps hold.
    at = SurfaceSample(random.normal(size=(300, 3)), np.tile([0.0, 0.0, 1.0], (300, 1)))
    guessed = guess_poses(at, np.eye(3), [grasp], spec, random)
    seen = np.einsum("kji,kj->ki", guessed.rotation, at.points - guessed.position)  # In the frames of the palms.
    middle = seen.mean(axis=0) - (grasp.centre - [grasp.diameter / 2.0, 0.0, 0.0])
    assert np.abs(middle).max() < 0.004
    assert (np.abs(seen - seen.mean(axis=0)).max(axis=0) < [0.022, 0.018, 0.026]).all()


def test_a_hand_that_is_inside_itself_is_no_candidate(tmp_path: Path) -> None:
    spec = hand("gripper", tmp_path)
    bench, above = bench_of(spec, "lemon"), np.array([0.0, 0.0, 0.4])
    down = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]).T
    for posture, free in ((spec.upper, True), (spec.lower, False)):
        row = PoseGuesses(above[None], down[None], posture[None], -np.ones((1, 1)), ["x"])
        bench.place(above, down, posture)
        assert (bench.overlap() < OVERLAP) == free
        assert (fit_palm(bench, row, 0, np.random.default_rng(0)) is not None) == free


def test_the_allegros_fingers_close_by_bending_and_not_by_spreading() -> None:
    spec = load_spec()
    all_fingers = [grasp for grasp in opposed("allegro") if len(grasp.fingers) == 4]
    assert len(all_fingers) >= 3
    for grasp in all_fingers:
        closing = closing_directions(grasp, spec).reshape(4, 4)
        assert closing[:3, 1:].all()
        assert not closing[:3, 0].any()


def test_a_gripper_by_its_card_is_proposed_grasps_that_physics_lets_pass_and_its_files_find_the_card(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    card = made("gripper", tmp_path / "mine")
    spec = load_spec("mine/gripper.yaml")
    search, bench, random = search_of(spec, "lemon"), bench_of(spec, "lemon"), np.random.default_rng(0)
    proposer = Proposer(bench, search.templates, 0.8, (0.0, np.pi / 2, np.pi), random)
    proposed = [candidate for candidate, _ in zip(filter(None, proposer.fresh()), range(4), strict=False)]
    performer = FingerGains(load_gains("default", spec), hand_kinematics(spec).gravity_torque)
    passed = [each.candidate for each in close_candidates(bench, proposed, performer, 0.8, random) if each.passed]
    assert passed
    prover = GraspValidator(
        bench, search.scenario, spec, search.templates, Path(), 0, Uncertainty(), search_symmetry(search)
    )
    (path,) = save_grasps(
        [PlannedGrasp(passed[0], *prover.as_files(passed[0], AS_IT_IS))], "lemon", tmp_path / "plans", spec
    )
    assert "hand: ../mine/gripper.yaml" in path.read_text()
    assert Path(hand_name({"scenario": path})).resolve() == card.resolve()


@pytest.mark.slow
def test_a_left_hand_by_its_card_is_planned_for_and_what_is_written_is_judged_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    card = made("gripper", tmp_path / "mine")
    write_settings(card, yaml.safe_load(card.read_text()) | {"side": "left"}, "gripper")
    spec = load_spec("mine/gripper.yaml")
    (planned,) = search_of(spec, "lemon", RoundSize(guessed=8, closed=4, drawn=1)).run(1, SearchBudget(400))
    (path,) = save_grasps([planned], "lemon", tmp_path / "plans", spec)
    assert load_scenario(path)[0].side == "left"
    again = load_spec(hand_name({"scenario": path}))
    (verdict,) = TrialRunner(again).verdicts([load_case({"scenario": path}, again)])
    assert verdict.report is not None
    assert verdict.report.margin == planned.margin


@pytest.mark.long
def test_a_gripper_by_its_card_plans_and_what_is_written_is_judged_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    made("gripper", tmp_path / "mine")
    spec = load_spec("mine/gripper.yaml")
    (planned,) = search_of(spec, "lemon", RoundSize(guessed=8, closed=4, drawn=1)).run(1, SearchBudget(400))
    (path,) = save_grasps([planned], "lemon", tmp_path / "plans", spec)
    again = load_spec(hand_name({"scenario": path}))
    (verdict,) = TrialRunner(again).verdicts([load_case({"scenario": path}, again)])
    assert verdict.report is not None
    assert verdict.report.margin == planned.margin


@pytest.mark.parametrize("turn", ['euler="0 0 90"', 'axisangle="0 1 0 40"', ""])
def test_a_palm_is_where_it_is_put_however_its_file_says_how_it_is_turned(
    turn: str, tmp_path: Path, make_sim: MakeSim, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(HANDS, "turned", GRIPPER.replace('euler="0 0 90"', turn))
    sim: SimBackend = make_sim(hand("turned", tmp_path), facing=(0, 0, -1), fingers=(1, 0, 0))
    sim.reset()
    frame = sim.data.body("palm_link").xmat.reshape(3, 3)
    np.testing.assert_allclose(frame[:, 0], [0.0, 0.0, -1.0], atol=1e-9)
    np.testing.assert_allclose(frame[:, 2], [1.0, 0.0, 0.0], atol=1e-9)


def test_a_hand_of_unknown_effort_is_not_planned_for(tmp_path: Path) -> None:
    path = made("gripper", tmp_path)
    path.write_text(path.read_text().replace("effort: 20.0", "effort: unknown"))
    with pytest.raises(ConfigError, match=r"gripper.yaml: the effort of all motors is unknown, so nobody could say"):
        check_efforts(load_spec(str(path)))
    scenario, _ = load_scenario("lemon")
    search = GraspImprovement(scenario, load_grasp(scenario.grasp, load_spec()), load_spec(str(path)))
    with pytest.raises(ConfigError, match="the effort of all motors is unknown"):
        search.run()
    check_efforts(load_spec("leap"))


@pytest.mark.parametrize("name", named("allegro", "leap", "model_o", "qb_softhand", "sih"))
def test_postures_of_the_library_that_are_made_by_the_rule_are_what_it_makes(name: str) -> None:
    """What a person has chosen is not: where the Allegro Hand begins and opens, and where the LEAP Hand begins."""
    spec = load_spec(name)
    own = {"allegro": {"home", "open"}, "leap": {"home"}}.get(name, set())
    for posture, wanted in card_postures(spec)[0].items():
        if posture not in own:
            np.testing.assert_allclose(load_posture(posture, spec), wanted, atol=2e-3)


def test_the_open_hand_has_its_thumb_turned_to_the_fingers_and_is_flat_but_for_it() -> None:
    spec = load_spec("leap")
    postures, _ = card_postures(spec)
    differs = postures["open"] != postures["flat"]
    assert differs[list(spec.finger("thumb").joints)].any()
    assert not differs[:12].any()
