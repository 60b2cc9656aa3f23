"""Other hands in `evaluate`: side by side as alone, under draws, and in one table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from allegro_twin.app.portraits import staged
from allegro_twin.control.controllers import ConstantCommand, PositionControl
from allegro_twin.controller import Controller
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.grasping.batch.batched_trials import run_trials
from allegro_twin.grasping.batch.trials import TrialCase, TrialRunner, load_case, run_cases
from allegro_twin.grasping.evaluation.campaign import TargetOptions, find_targets
from allegro_twin.grasping.evaluation.outcomes import rates
from allegro_twin.grasping.metrics.trial_metrics import NAMES, trial_metrics
from allegro_twin.grasping.scenario import TrialProtocol
from allegro_twin.grasping.trial import Trial
from allegro_twin.grasping.uncertainty import Perturbation
from allegro_twin.grasping.verdict import TrialReport
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.limits import hand_limits
from allegro_twin.hands.settings import LimitSettings
from allegro_twin.loop import run, until
from allegro_twin.safety import Guard
from allegro_twin.sim.batch.separate_models import SeparateModelBatch
from allegro_twin.sim.drivetrain.transmission import sum_each
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.types import PositionCommand
from tests.conftest import MakeSim
from tests.hands.models import hand, made

BRIEF = TrialProtocol.model_validate({
    "version": 1, "period": 0.004, "physics": {"timestep": 0.002}, "reference": "squeeze",
    "phases": [
        {"name": "approach", "seconds": 0.3, "hand": "preshape", "wrist": "approach"},
        {"name": "close", "seconds": 0.4, "hand": "close"},
        {"name": "squeeze", "seconds": 0.2, "hand": "squeeze"},
        {"name": "lift", "seconds": 0.1, "move": (0.0, 0.0, 0.01), "check": True},
    ],
})  # fmt: skip
DRAW = Perturbation(0.004, -0.003, 0.1, 1.04, 0.9, 0.6, 0.8)
OTHERS = {"leap": "leap_mug", "model_o": "model_o_lemon", "qb_softhand": "qb_softhand_lemon"}


def brief(bench: TrialRunner, scenario: str, draw: Perturbation | None = None) -> TrialCase:
    case = load_case({"scenario": scenario}, bench.spec)
    return TrialCase(case.scenario, case.grasp, draw, BRIEF, case.folder)


def alone(trial: Trial, controller: Controller[Any]) -> TrialReport:
    """In the ordinary loop, behind the guard."""
    guarded = Guard(trial.backend, hand_limits(LimitSettings(), trial.backend.spec))
    for _ in trial.watched(until(trial.seconds, run(guarded, controller))):
        pass
    return trial.report()


def told(report: TrialReport | None) -> list[Any]:
    """What is the same of two trials to the last bit, of one that took some torque."""
    assert report is not None
    assert report.peak_torque > 0.0
    phases = [(phase.drift, phase.rotation, phase.margin) for phase in report.phases]
    return [*phases, report.lift, report.peak_torque, report.at_limit]


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
def test_each_of_several_trials_of_any_hand_moves_as_if_it_were_alone(name: str) -> None:
    bench = TrialRunner(load_spec(name), period=0.004)
    cases = [brief(bench, OTHERS[name], draw) for draw in (None, DRAW)]
    for case, verdict in zip(cases, bench.verdicts(cases), strict=True):
        trial = bench.trial(case)
        assert told(alone(trial, bench.controller(trial))) == told(verdict.report)


ORDERS = {
    "model_o": PositionCommand(np.array([0.4, 2.0, 2.0, 2.0]), effort=np.array([0.04, 0.5, 0.6, 0.7])),
    "qb_softhand": PositionCommand(np.array([0.6]), duration=0.5),
}


@pytest.mark.parametrize("name", ORDERS)
def test_efforts_and_durations_side_by_side_are_those_of_a_hand_alone(name: str) -> None:
    bench = TrialRunner(load_spec(name), period=0.004)
    case, controller = brief(bench, OTHERS[name]), ConstantCommand(ORDERS[name])
    others = [bench.trial(case) for _ in range(2)]
    slower = ConstantCommand(PositionCommand(0.5 * ORDERS[name].position, duration=ORDERS[name].duration))
    found = run_trials(others, [controller, slower], bench.limits)
    assert told(found[0].report) == told(alone(bench.trial(case), controller))
    assert found[1].report is not None
    assert found[0].report is not None
    assert found[0].report.peak_torque != found[1].report.peak_torque


@pytest.mark.parametrize("name", ["allegro", "leap", "model_o", "sih", "qb_softhand"])
@pytest.mark.parametrize("n", [2, 9])
def test_hands_side_by_side_say_where_they_are_as_a_hand_alone_does(name: str, n: int, make_sim: MakeSim) -> None:
    """To the bit, from any posture: also where a motor's position is a sum over many joints that follow."""
    spec, rng = load_spec(name), np.random.default_rng(n)
    postures = rng.uniform(spec.lower, spec.upper, (n, spec.n_joints))
    single = [make_sim(spec, posture=posture) for posture in postures]
    states = [sim.reset() for sim in single]
    sims = SeparateModelBatch(spec, [sim.model for sim in single])
    sims.place(np.arange(n), np.array([sim.posture for sim in single]))
    sims.begin(np.zeros((n, 6)))
    still = np.zeros((n, spec.n_joints))
    for _ in range(5):
        np.testing.assert_array_equal(sims.position, [state.position for state in states])
        np.testing.assert_array_equal(sims.velocity, [state.velocity for state in states])
        states = [sim.read() for sim in single]
        sims.advance(np.arange(n), still, np.zeros((n, 1, 6)), single[0].substeps)


def test_equal_terms_have_equal_sums_however_they_lie_in_memory() -> None:
    terms = np.random.default_rng(0).uniform(-1.0, 1.0, (7, 3, 33))
    alone = [[sum_each(row) for row in part] for part in terms]
    for lie in (np.ascontiguousarray, np.asfortranarray):
        np.testing.assert_array_equal(sum_each(lie(terms)), alone)
    np.testing.assert_array_equal(sum_each(terms[::-1][:, ::-1])[::-1, ::-1], alone)


def test_a_controllers_effort_and_the_guards_ceiling_hold_side_by_side_too() -> None:
    bench = TrialRunner(load_spec("model_o"), period=0.004)
    case, limits = brief(bench, OTHERS["model_o"]), replace(bench.limits, torque=0.1 * bench.limits.torque)
    efforts = [None, 0.05 * bench.limits.torque, bench.limits.torque]
    trials = [bench.trial(case) for _ in efforts]
    found = run_trials(trials, [PositionControl(t.reference, e) for t, e in zip(trials, efforts, strict=True)], limits)
    peaks = [verdict.report.peak_torque for verdict in found if verdict.report is not None]
    assert peaks[0] == peaks[2] == pytest.approx(0.1)
    assert peaks[1] == pytest.approx(0.05)


def test_no_motor_gives_more_than_its_card_says_whatever_its_file_lets_it(tmp_path: Path) -> None:
    card = made("gripper", tmp_path)
    card.write_text(card.read_text().replace("effort: 20.0", "effort: 5.0"))
    sim = TrialRunner(load_spec(str(card)), period=0.004).trial(_gripping(tmp_path, str(card))).backend
    assert sim.model.actuator("left").forcerange.tolist() == [-5.0, 5.0]


@pytest.mark.parametrize("name", ["model_o", "leap"])
def test_strong_and_weak_motors_are_both_drawn_for_a_hand_that_closes_its_own_loop(name: str) -> None:
    spec = load_spec(name)
    bench = TrialRunner(spec, period=0.004)
    for factor in (0.7, 1.3):
        model = bench.trial(brief(bench, OTHERS[name], Perturbation(torque=factor))).backend.model
        ids = [model.actuator(joint).id for joint in spec.joints]
        np.testing.assert_allclose(model.actuator_forcerange[ids, 1], factor * spec.actuation.torque_limit)


def test_a_session_begins_limp_however_the_last_one_ended(make_sim: MakeSim) -> None:
    spec = load_spec("leap")
    sim: SimBackend = make_sim(spec, posture=np.full(16, 0.4))
    first = sim.reset()
    sim.write(PositionCommand(np.zeros(16)))
    sim.read()
    again = sim.reset()
    assert not first.torque.any()
    np.testing.assert_array_equal(first.torque, again.torque)


def test_asking_where_a_tendon_hand_is_leaves_its_simulation_as_the_step_left_it(make_sim: MakeSim) -> None:
    """So that the palm and the fingers of a recording are of one moment, as they are with any other hand."""
    sim = make_sim(load_spec("model_o"))
    sim.reset()
    sim.write(PositionCommand(np.array([0.0, 3.0, 3.0, 3.0])))
    for _ in range(50):
        state = sim.read()
    now = mujoco.MjData(sim.model)
    now.qpos[:], now.qvel[:] = sim.data.qpos, sim.data.qvel
    mujoco.mj_forward(sim.model, now)
    assert np.abs(sim.data.xpos - now.xpos).max() > 1e-6, "as they were before the last step"
    motors = [sim.model.actuator(name).id for name in sim.spec.joints]
    np.testing.assert_allclose(state.position, now.actuator_length[motors], atol=1e-12)
    np.testing.assert_allclose(state.velocity, now.actuator_velocity[motors], atol=1e-12)


def test_a_hand_by_its_card_is_side_by_side_what_it_is_alone(tmp_path: Path) -> None:
    """One motor on a slide, and a linkage."""
    spec = hand("gripper", tmp_path)
    bench = TrialRunner(spec, period=0.004)
    case = _gripping(tmp_path, str(tmp_path / "gripper.yaml"))
    trial = bench.trial(case)
    (verdict,) = bench.verdicts([case])
    assert told(alone(trial, bench.controller(trial))) == told(verdict.report)


def _gripping(folder: Path, card: str) -> TrialCase:
    """A lemon, which it squeezes."""
    path, spec = folder / "grip.yaml", load_spec(card)
    path.write_text(
        f"hand: {spec.model}\ntaxonomy: {{number: 31, name: Ring, type: power, opposition: pad}}\n"
        "preshape: {left: [0.03]}\nclose: {left: [0.0]}\nsqueeze: {left: [-0.02]}\n"
    )
    case = load_case({"scenario": "lemon", "grasp": str(path)}, spec)
    return TrialCase(case.scenario, case.grasp, None, BRIEF, case.folder)


def test_a_table_of_several_hands_has_a_rate_for_each(tmp_path: Path) -> None:
    rules = tmp_path / "brief.yaml"
    rules.write_text(BRIEF.model_dump_json())
    paths = [data_root() / f"scenarios/{name}/{OTHERS[name]}.yaml" for name in ("leap", "model_o")]
    targets = find_targets(paths, TargetOptions(str(rules)))
    assert [target.spec.model for target in targets] == ["leap", "model_o"]
    rows = run_cases({"metrics": True}, [target.item for target in targets])
    assert [row["hand"] for row in rows] == ["leap", "model_o"]
    assert [(each.name, each.n) for each in rates(rows, "hand")] == [("leap", 1), ("model_o", 1)]
    assert staged(targets[1]).spec.model == "model_o"


def test_metrics_of_a_tendon_hands_contacts_leave_out_what_depends_on_springs() -> None:
    pytest.importorskip("scipy", reason="metrics of contacts need SciPy: extra objects")
    bench = TrialRunner(load_spec("model_o"), period=0.004)
    trial = bench.trial(brief(bench, OTHERS["model_o"]))
    alone(trial, bench.controller(trial))
    found = trial_metrics(trial, trial.backend.data)
    assert set(found) == set(NAMES)
    assert found["fingers"] >= 2
    assert np.isnan(found["least_torque"])


def test_a_right_hand_alone_has_no_left_one_to_evaluate() -> None:
    path = data_root() / "scenarios/model_o/model_o_lemon.yaml"
    with pytest.raises(ConfigError, match=r"model_o.yaml is a right hand; hand.side is left"):
        find_targets([path], TargetOptions(sides=("left",)))
