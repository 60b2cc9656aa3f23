"""Trials side by side are the trials that they would be alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from itertools import pairwise
from typing import Any, get_args

import numpy as np
import pytest
from scipy.stats import qmc  # type: ignore[import-untyped]  # Its types are a package of its own.

from allegro_twin.app import assemble
from allegro_twin.app.simulated import scenario_config
from allegro_twin.control.controllers import PD
from allegro_twin.control.motion_feedforward import MotionFeedforward
from allegro_twin.controller import Controller
from allegro_twin.grasping import uncertainty
from allegro_twin.grasping.batch import trials
from allegro_twin.grasping.batch.batched_trials import Verdict
from allegro_twin.grasping.batch.trial_loop import TrialLoop
from allegro_twin.grasping.batch.trials import TrialCase, TrialRunner, load_case, run_cases
from allegro_twin.grasping.controller import TimedGrasp, make_grasp_controller
from allegro_twin.grasping.scenario import Phase, TrialProtocol, load_protocol, load_scenario, turn_pushes
from allegro_twin.grasping.trial import Trial
from allegro_twin.grasping.uncertainty import Perturbation, SampleStream, Uncertainty, sample_perturbations
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import CentroidGrip, LatchGrip
from allegro_twin.hands.limits import hand_limits
from allegro_twin.hands.settings import LimitSettings
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.loop import run, until
from allegro_twin.safety import Guard
from allegro_twin.sim.batch.separate_models import SeparateModelBatch
from allegro_twin.sim.model import compiled_scenes
from allegro_twin.sim.model.physics import Physics
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

SHORT = load_protocol("table_pick")
SHORT = SHORT.model_copy(
    update={"phases": tuple(p.model_copy(update={"check": p.name == "lift"}) for p in SHORT.phases[:5])}
)
"""To the end of the lift."""


def alone(case: TrialCase, bench: TrialRunner) -> Trial:
    """The trial in the ordinary loop, behind the guard, with the ordinary controller, run to its end."""
    trial = bench.trial(case)
    rig = assemble(scenario_config("lemon"))
    assert isinstance(rig.controller, PD)
    assert rig.controller.gravity is not None
    controller: Controller[Any] = PD(trial.reference, rig.controller.gains, rig.controller.gravity)
    if trial.grasp.grip is not None:
        timed = TimedGrasp(trial.reference, trial.begin_of("close"), trial.begin_of("squeeze"))
        controller = make_grasp_controller(
            trial.grasp, timed, bench.spec, rig.controller.gains, rig.controller.gravity, hand_kinematics(bench.spec)
        )
    hand = Guard(trial.backend, hand_limits(LimitSettings(), bench.spec))
    for _ in trial.watched(until(trial.seconds, run(hand, controller))):
        pass
    return trial


@pytest.fixture(scope="module")
def bench() -> TrialRunner:
    return TrialRunner(load_spec())


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many trials each period of physics was for."""
    counts, advance = list[int](), SeparateModelBatch.advance

    def counted(sims: SeparateModelBatch, rows: Any, *others: Any) -> None:
        counts.append(len(rows))
        advance(sims, rows, *others)

    monkeypatch.setattr(SeparateModelBatch, "advance", counted)
    return counts


@pytest.mark.slow
@pytest.mark.parametrize(
    "draw", [pytest.param(None, marks=pytest.mark.long), Perturbation(0.004, -0.003, 0.1, 1.04, 0.9, 0.6, 0.8)]
)
def test_each_of_several_trials_moves_as_if_it_were_alone(draw: Perturbation | None, bench: TrialRunner) -> None:
    cases = [load_case({"scenario": name, "draw": draw and asdict(draw)}, bench.spec) for name in ("lemon", "mug")]
    cases = [TrialCase(c.scenario, c.grasp, c.draw, SHORT, c.folder) for c in cases]
    cases.append(replace(cases[0], grasp=replace(cases[0].grasp, grip=LatchGrip(kind="latch"))))
    for case, verdict in zip(cases, bench.verdicts(cases), strict=True):
        report, other = alone(case, bench).report(), verdict.report
        assert other is not None
        for ours, theirs in zip(report.phases, other.phases, strict=True):
            assert (ours.drift, ours.rotation, ours.margin) == (theirs.drift, theirs.rotation, theirs.margin)
        assert (report.lift, report.peak_torque, report.at_limit) == (other.lift, other.peak_torque, other.at_limit)


def test_a_controller_that_feeds_inverse_dynamics_forward_does_so_beside_others(
    bench: TrialRunner, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[Array]()

    def rigid(position: Array, velocity: Array, acceleration: Array) -> Array:
        asked.append(position)
        return np.zeros(16)

    motion = MotionFeedforward(rigid, bench.spec.actuation)
    usual = TrialRunner.controller
    monkeypatch.setattr(TrialRunner, "controller", lambda own, trial: replace(usual(own, trial), motion=motion))
    case = replace(load_case({"scenario": "lemon"}, bench.spec), protocol=SHORT)
    (verdict,) = bench.verdicts([case])
    assert verdict.report is not None
    assert len(asked) > 500


def test_a_push_moves_a_body_that_nothing_holds_as_newton_says(bench: TrialRunner) -> None:
    """½ a t² after t; the hand is far away."""
    protocol = TrialProtocol.model_validate({
        "version": 1, "floating": True, "reference": "wait", "physics": {"gravity": (0.0, 0.0, 0.0)},
        "phases": [{"name": "wait", "seconds": 0.03}, {"name": "push", "seconds": 0.3, "push": (0.0, 2.0, 0.0)}],
    })  # fmt: skip
    case = load_case({"scenario": "lemon"}, bench.spec)
    wrist = case.scenario.wrist.model_copy(update={"position": (0.0, 0.0, 0.5)})
    scenario = case.scenario.model_copy(update={"wrist": wrist})
    trial = alone(TrialCase(scenario, case.grasp, None, protocol), bench)
    body = trial.backend.data.body("lemon")
    assert trial.report().phases[0].drift == pytest.approx(0.5 * 2.0 * 0.3**2, rel=0.01)
    assert trial.mass == pytest.approx(0.029)
    assert body.xpos[1] == pytest.approx(0.09, rel=0.01)


def test_a_phase_without_a_push_pushes_nothing() -> None:
    assert Phase(name="wait", seconds=1.0).push == (0.0, 0.0, 0.0)


def test_the_same_number_is_the_same_case_for_every_object_and_however_many_are_drawn() -> None:
    few, many = sample_perturbations(Uncertainty(), 3, seed=7), sample_perturbations(Uncertainty(), 10, seed=7)
    assert few == many[:3]
    assert sample_perturbations(Uncertainty(), 4, seed=7, first=3) == many[3:7]
    assert sample_perturbations(Uncertainty(), 3, seed=8) != few


@pytest.mark.parametrize("count", [2, 4, 8, 16, 32])
def test_the_first_draws_of_a_search_have_every_measure_once_in_each_part_of_its_range(count: int) -> None:
    for seed in range(5):
        found = sample_perturbations(Uncertainty(), count, seed, stream="search")
        assert found[1:] == sample_perturbations(Uncertainty(), count - 1, seed, first=1, stream="search")
        of = [(d.x / 0.02 + 0.5, d.yaw / np.radians(20.0) + 0.5, (d.size - 0.95) / 0.1, (d.mass - 0.8) / 0.4,
               2.0 * ((d.friction or 0.0) - 0.5), (d.torque - 0.7) / 0.6) for d in found]  # fmt: skip
        for measure in np.array(of).T:
            assert sorted((measure * count).astype(int)) == list(range(count))


def test_draws_of_a_search_are_sobol_s_but_for_a_shift_of_their_digits(monkeypatch: pytest.MonkeyPatch) -> None:
    class Unshifted:
        def integers(self, low: int, high: int, size: int) -> Any:
            return np.zeros(size, dtype=np.int64)

    monkeypatch.setattr(np.random, "default_rng", lambda seed: Unshifted())
    found = uncertainty._spread(0, 0, 256)
    theirs = 2.0 * qmc.Sobol(7, scramble=False).random(256) - 1.0
    np.testing.assert_allclose(found[np.lexsort(found.T)], theirs[np.lexsort(theirs.T)], atol=1e-5)


def test_what_is_chosen_on_some_draws_is_never_judged_on_them() -> None:
    """Streams share no draw, whatever their seeds: `plan` chose on the first twenty that `evaluate` then repeated."""
    streams: tuple[SampleStream, ...] = get_args(SampleStream)
    found = [
        (each.x, each.y)
        for stream in streams
        for seed in range(5)
        for each in sample_perturbations(Uncertainty(), 50, seed, stream=stream)
    ]
    assert len(set(found)) == len(found) == 50 * 5 * 3


def test_draws_fill_their_ranges_and_no_more() -> None:
    found = sample_perturbations(Uncertainty(), 500)
    for name, low, high in [("x", -0.01, 0.01), ("yaw", -0.1745, 0.1745), ("size", 0.95, 1.05), ("mass", 0.8, 1.2),
                            ("friction", 0.5, 1.0), ("torque", 0.7, 1.3)]:  # fmt: skip
        values = np.array([getattr(draw, name) for draw in found])
        assert low <= values.min() < low + 0.02 * (high - low)
        assert high - 0.02 * (high - low) < values.max() <= high + 1e-4


def test_a_larger_object_stands_higher_and_the_hand_stays_where_it_was(bench: TrialRunner) -> None:
    nominal, large = (
        load_case({"scenario": "mug", "draw": d}, bench.spec) for d in (None, asdict(Perturbation(size=1.05)))
    )
    first, second = bench.trial(nominal), bench.trial(large)
    assert second.objects[0].position[2] - first.objects[0].position[2] == pytest.approx(0.05 * 0.041)
    assert (first.backend.model.body("palm_link").pos == second.backend.model.body("palm_link").pos).all()
    assert second.mass == first.mass


def test_weak_motors_give_what_they_are_told_times_a_factor(bench: TrialRunner) -> None:
    weak = bench.trial(load_case({"scenario": "mug", "draw": asdict(Perturbation(torque=0.7))}, bench.spec))
    assert weak.backend.model.actuator_gear[weak.backend.model.actuator("joint_0.0").id, 0] == pytest.approx(0.7)


def test_trials_of_one_scene_are_compiled_once_and_share_nothing_that_is_changed(
    bench: TrialRunner, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled = list[Stage]()

    def counted(spec: HandSpec, stage: Stage) -> Any:
        compiled.append(stage)
        return compile_scene(spec, stage)

    monkeypatch.setattr(compiled_scenes, "compile_scene", counted)
    scenes = compiled_scenes.CompiledScenes(bench.spec)
    gears = []
    for draw in (Perturbation(torque=0.7), Perturbation(), None, Perturbation(x=0.001), Perturbation(friction=0.5)):
        case = load_case({"scenario": "mug", "draw": None if draw is None else asdict(draw)}, bench.spec)
        model = bench.trial(case, scenes).backend.model
        gears.append(float(model.actuator_gear[model.actuator("joint_0.0").id, 0]))
    assert gears == [0.7, 1.0, 1.0, 1.0, 1.0]
    assert len(compiled) == 3
    first = compiled[0]
    for other in (
        replace(first, position=first.position + 0.01), replace(first, quaternion=-first.quaternion),
        replace(first, objects=first.objects[:0]), replace(first, physics=Physics(timestep=0.002)),
        replace(first, table=False), replace(first, edge=0.2),
    ):  # fmt: skip
        scenes.model(other)
        assert compiled[-1] is other


def test_who_does_not_ask_for_the_type_gets_the_same_verdict_without_it(bench: TrialRunner) -> None:
    short = SHORT.model_copy(update={"phases": SHORT.phases[1:]})
    asked = replace(load_case({"scenario": "golf_ball"}, bench.spec), protocol=short)
    typed, plain = (verdict.report for verdict in bench.verdicts([asked, replace(asked, typed=False)]))
    assert typed is not None
    assert plain is not None
    assert typed.observed is not None
    assert plain.observed is None
    assert plain == typed, "but for the type, which does not count"


def pushed(gravity: float = 0.0) -> TrialProtocol:
    """Closed on an object that floats, which is pushed along each axis."""
    return TrialProtocol.model_validate({
        "version": 1, "floating": True, "reference": "start", "directions": 6,
        "physics": {"timestep": 0.003, "gravity": (0.0, 0.0, gravity)}, "success": {"throughout": True},
        "phases": [
            {"name": "start", "seconds": 0.003}, {"name": "close", "seconds": 0.12, "hand": "close"},
            {"name": "squeeze", "seconds": 0.06, "hand": "squeeze"},
            {"name": "hold", "seconds": 0.03, "check": True},
            {"name": "push", "seconds": 0.09, "push": (10.0, 0.0, 0.0), "check": True},
        ],
    })  # fmt: skip


CENTROID = CentroidGrip(kind="centroid", fingers=("index", "middle", "thumb"))


@pytest.mark.parametrize(
    ("name", "grip"),
    [("lemon", None), ("lemon", LatchGrip(kind="latch")), ("lemon", CENTROID),
     ("sih_lemon", None)],
)  # fmt: skip
def test_pushes_of_one_grasp_share_their_beginning_and_are_what_each_is_alone(
    name: str, grip: LatchGrip | CentroidGrip | None, steps: list[int]
) -> None:
    """To the bit, also where fingers latch or follow another law, and in hands that close their own loop; until the
    first push, or the first check."""
    bench = TrialRunner(load_spec(load_scenario(name)[0].hand))
    case = load_case({"scenario": name}, bench.spec)
    case = replace(case, grasp=replace(case.grasp, grip=grip), protocol=pushed(gravity=-0.5))
    others = [
        replace(case, protocol=pushed(gravity=-0.6)), replace(case, draw=Perturbation(mass=1.1)),
        replace(case, scenario=case.scenario.model_copy()), replace(case, grasp=replace(case.grasp)),
    ]  # fmt: skip
    ways = case.directions()
    first, *rest = (other.directions()[0] for other in others)
    beside = [each for other in rest for each in (other, ways[0])]
    together = list(bench.verdicts([first, *ways, *beside]))[1:7]
    before, after = 60, 41  # Periods. All are told what is told in the last one before.
    assert steps == [8] * before + [13] * after
    steps.clear()
    apart = [verdict.report for way in ways for verdict in bench.verdicts([way])]
    assert steps == [1] * (6 * (before + after))
    assert [verdict.report for verdict in together] == apart
    assert len({report.phases[-1].drift for report in apart if report is not None}) == 6
    seen = [report.observed for report in apart if report is not None]
    assert [verdict.report.observed for verdict in together if verdict.report is not None] == seen


def test_a_hand_that_goes_on_from_where_another_is_goes_on_with_its_timed_command() -> None:
    spec = load_spec("sih")
    case = load_case({"scenario": "sih_lemon"}, spec)
    models = [TrialRunner(spec).trial(case).backend.model for _ in range(2)]
    sims = SeparateModelBatch(spec, models)
    first, second = np.array([[0], [1]])
    sims.begin(np.zeros((2, 6)))
    still = np.zeros((1, 1, 6))
    sims.advance(
        first, sims.servo_control(first, 0.5 * spec.upper[None], 0.5 * spec.actuation.torque_limit[None], 0.3), still, 1
    )
    sims.copy(second, first)
    assert sims.servos is not None
    assert (sims.servos.commands(first) == sims.servos.commands(second)).all()
    assert (models[0].actuator_forcerange == models[1].actuator_forcerange).all()
    assert (sims.position[0] == sims.position[1]).all()


def test_what_stops_before_any_push_stops_for_all_of_them(bench: TrialRunner) -> None:
    case = replace(load_case({"scenario": "lemon"}, bench.spec), protocol=pushed())
    slow = TrialRunner(bench.spec)
    slow.limits = replace(slow.limits, velocity=slow.limits.velocity * 1e-3)
    found = list(slow.verdicts(case.directions()))
    assert len({verdict.stopped for verdict in found}) == 1
    assert "rad/s" in found[0].stopped
    (alone,) = slow.verdicts(case.directions()[5:])
    assert found[0].stopped == alone.stopped
    assert all(verdict.too_fast for verdict in (*found, alone))
    assert not next(bench.verdicts(case.directions()[5:])).too_fast


def test_in_haste_the_first_push_that_takes_an_object_away_ends_the_others(
    bench: TrialRunner, steps: list[int]
) -> None:
    """But those of no other grasp, and of this one only in haste."""
    case = replace(load_case({"scenario": "lemon"}, bench.spec), protocol=pushed())
    strong = turn_pushes(pushed(), 0, 100.0)
    cases = [
        replace(case, protocol=strong),
        case.directions()[2],
        replace(case.directions()[2], grasp=replace(case.grasp)),
    ]
    hasty, patient = list(bench.verdicts(cases, stop_early=True)), list(bench.verdicts(cases))
    assert hasty[0].stopped.startswith("moved ")
    assert [verdict.stopped for verdict in hasty[1:]] == ["lost under another push", ""]
    assert [verdict.held for verdict in patient] == [False, True, True]
    assert steps[60] == 3
    assert steps[100] == 1


def test_in_haste_contacts_are_looked_at_only_at_the_ends_of_phases_where_nobody_asks_for_the_type(
    bench: TrialRunner, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks, touch = list[int](), TrialLoop.touch

    def counted(loop: TrialLoop, row: int) -> Any:
        looks.append(loop.tick)
        return touch(loop, row)

    monkeypatch.setattr(TrialLoop, "touch", counted)
    case = replace(load_case({"scenario": "lemon"}, bench.spec), protocol=pushed()).directions()[2]
    found = []
    for typed, haste in ((False, True), (True, True), (False, False)):
        looks.append(-1)
        found.append(next(bench.verdicts([replace(case, typed=typed)], stop_early=haste)).report)
    few, many, patient = (list(each) for _, *each in _split(looks))
    assert few == [1, 41, 61, 71, 101]
    assert many == patient == sorted({*few, *range(10, 101, 10)})
    reports = [report for report in found if report is not None]
    assert len({(each.margin, each.lift, each.peak_torque, *each.sustained.values()) for each in reports}) == 1
    assert len(reports) == 3


def _split(looks: list[int]) -> list[list[int]]:
    starts = [*(k for k, tick in enumerate(looks) if tick < 0), len(looks)]
    return [looks[a:b] for a, b in pairwise(starts)]


def test_pushes_of_one_grasp_stay_side_by_side_where_there_are_more_than_go_side_by_side(
    bench: TrialRunner, monkeypatch: pytest.MonkeyPatch, steps: list[int]
) -> None:
    monkeypatch.setattr(trials, "WIDTH", 8)
    case = replace(load_case({"scenario": "lemon"}, bench.spec), protocol=pushed())
    other = replace(case, grasp=replace(case.grasp))
    found = list(bench.verdicts([*case.directions(), *other.directions()]))
    assert set(steps) == {1, 6}
    assert [verdict.report for verdict in found[:6]] == [verdict.report for verdict in found[6:]]


def test_of_a_hand_whose_models_are_large_fewer_trials_go_side_by_side(
    bench: TrialRunner, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts: list[int] = []

    def run_trials(made: Sequence[Trial], *_: Any, **__: Any) -> list[Verdict]:
        counts.append(len(made))
        return []

    monkeypatch.setattr(trials, "run_trials", run_trials)
    case = load_case({"scenario": "lemon"}, bench.spec)
    cases = [replace(case, grasp=replace(case.grasp)) for _ in range(5)]
    assert not [*bench.verdicts(cases)]
    monkeypatch.setattr(trials, "MEMORY", 1000)
    monkeypatch.setattr(trials, "FEWEST", 2)
    assert not [*bench.verdicts(cases)]
    assert counts == [5, 2, 2, 1]


@pytest.mark.long
def test_a_unit_of_a_sweep_is_rows_in_the_order_of_its_items() -> None:
    items = [{"scenario": "lemon", "side": "left"}, {"scenario": "mug"}, {"scenario": "lemon"}]
    rows = run_cases({}, items)
    assert [(row["object"], row["side"]) for row in rows] == [("lemon", "left"), ("mug", "right"), ("lemon", "right")]
    assert run_cases({}, items[1:2])[0] == rows[1]


@pytest.mark.slow
def test_in_haste_the_same_trials_hold_and_what_is_lost_at_a_check_goes_no_further() -> None:
    bench = TrialRunner(load_spec())
    whole = load_case({"scenario": "lemon", "protocol": "quick"}, bench.spec)
    missed = TrialCase(
        whole.scenario, whole.grasp, Perturbation(0.03, 0.03, 0.0, 1.0, 1.0, 0.5, 1.0), whole.protocol, whole.folder
    )
    patient, hasty = list(bench.verdicts([whole, missed])), list(bench.verdicts([whole, missed], stop_early=True))
    assert [v.held for v in patient] == [v.held for v in hasty] == [True, False]
    assert hasty[0].report is not None
    assert patient[0].report is not None
    assert hasty[0].report.margin == patient[0].report.margin
    assert patient[1].report is not None
    assert hasty[1].report is None
    assert hasty[1].stopped.startswith("moved ")
