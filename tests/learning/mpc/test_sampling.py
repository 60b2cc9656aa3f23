"""Sampling finds actions that a task's reward asks for, from any moment of an episode, and for any hand."""

from __future__ import annotations

import math
import re
from typing import Any, Literal

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.orientation import quaternion_product
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.environments.snapshot import spread_snapshot
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.mpc.episodes import run_episodes
from allegro_twin.learning.mpc.rollouts import Rollouts, planner_environment
from allegro_twin.learning.mpc.sampling import Plan, SamplingMpc
from allegro_twin.learning.mpc.settings import CostSettings, MpcSettings, planner_settings
from allegro_twin.learning.tasks.base import StepOutcome
from allegro_twin.sim.batch.link_contacts import LinkContacts

NO_STEPS = np.zeros((0, 2, 16))
QUICK = MpcSettings(samples=12, horizon=0.3, hold=0.0, knots=2, iterations=1)


@pytest.mark.parametrize("task", ["Reach", "Grasp", "Rotate"])
def test_every_simulation_of_a_batch_goes_on_from_one_episode_to_the_bit(task: str) -> None:
    keywords: dict[str, Any] = {"timestep": 0.003, "randomise": "default"}
    single, batch = HandEnv(task, **keywords), HandVectorEnv(task, 3, autoreset_mode="disabled", **keywords)
    single.reset(seed=4)
    batch.reset(seed=99)
    rng = np.random.default_rng(0)
    for _ in range(3):
        single.step(rng.uniform(-0.5, 0.5, 16).astype(np.float32))
    state = single.save_state()
    spread_snapshot(batch, state.parts)
    for _ in range(6):
        action = rng.uniform(-0.5, 0.5, 16).astype(np.float32)
        observation, reward, failed, _, _ = single.step(action)
        seen, rewards, lost, _, _ = batch.step(np.stack([action] * 3))
        rows = np.concatenate([np.reshape(part, (3, -1)) for part in _parts(seen)], axis=-1)
        one = np.concatenate([np.ravel(part) for part in _parts(observation)])
        for row in range(3):
            np.testing.assert_array_equal(rows[row], one)
        assert rewards.tolist() == [reward] * 3
        assert lost.tolist() == [failed] * 3


def _parts(observation: Any) -> list[Any]:
    return list(observation.values()) if isinstance(observation, dict) else [observation]


@pytest.mark.parametrize(
    ("hand", "method"),
    [
        ("allegro", "cem"),
        pytest.param("leap", "mppi", marks=pytest.mark.slow),
        pytest.param("allegro", "predictive", marks=pytest.mark.slow),
        pytest.param("leap", "cem", marks=pytest.mark.slow),
    ],
)
def test_fingertips_come_nearer_to_their_goals(hand: str, method: Literal["cem", "mppi", "predictive"]) -> None:
    environment = EnvSettings(timestep=0.003, hand=hand)
    chosen = QUICK.model_copy(update={"method": method, "iterations": 2})
    still = HandEnv("Reach", timestep=0.003, hand=hand)
    still.reset(seed=3)
    nothing = sum(still.step(np.zeros(16, np.float32))[1] for _ in range(15))
    (found,) = run_episodes("Reach", environment, chosen, 1, seed=3, seconds=15 * 0.039, threads=1)
    assert found.seconds == pytest.approx(15 * 0.039)
    assert found.total > 0.8 * nothing  # Both are below 0.


def test_the_same_seed_plans_the_same_and_planning_leaves_the_episode_alone() -> None:
    environment = EnvSettings(timestep=0.003)
    env = HandEnv("Reach", timestep=0.003)
    env.reset(seed=3)
    state = env.save_state()
    plans = [SamplingMpc("Reach", environment, QUICK, threads=1).plan(state) for _ in range(2)]
    np.testing.assert_array_equal(plans[0], plans[1])
    again = env.save_state()
    assert all(np.array_equal(state.parts[name], again.parts[name], equal_nan=False) for name in state.parts)


def test_a_spline_goes_through_its_knots_and_moves_on_by_a_decision() -> None:
    mpc = SamplingMpc("Reach", EnvSettings(timestep=0.003), MpcSettings(samples=2, horizon=0.39, knots=4), threads=1)
    assert mpc.decisions == 10
    knots = np.arange(4.0)[None, :, None] * np.ones((1, 1, 16))
    actions = mpc._spline(knots)[:, 0].astype(np.float32)
    np.testing.assert_allclose(actions[:, 0], np.linspace(0.0, 3.0, 10), rtol=1e-6)
    mpc.move_on(Plan(actions, 0.0))
    np.testing.assert_allclose(mpc._mean[0], actions[1])
    np.testing.assert_allclose(mpc._mean[-1], 0.0)
    np.testing.assert_allclose(mpc._last, actions[0])
    mpc.move_on(Plan(actions, 0.0), 3)
    np.testing.assert_allclose(mpc._mean[0], actions[3])
    np.testing.assert_allclose(mpc._last, actions[2])
    mpc.move_on(Plan(actions, 0.0), 50)
    np.testing.assert_allclose(mpc._mean, 0.0)


def test_a_plan_is_the_last_one_moved_on_where_nothing_else_is_tried() -> None:
    settings = MpcSettings(samples=2, horizon=0.39, knots=10, iterations=1, method="predictive", spread=1e-12)
    mpc = SamplingMpc("Reach", EnvSettings(timestep=0.003), settings.model_copy(update={"narrowest": 1e-12}), threads=1)
    env = HandEnv("Reach", timestep=0.003)
    env.reset(seed=3)
    mpc._mean = np.linspace(0.0, 0.9, 10)[:, None] * np.ones((1, 16))
    for action in (0.0, 0.1, 0.2):
        np.testing.assert_allclose(mpc.plan(env.save_state()), action, atol=1e-6)


def test_what_comes_after_a_failure_counts_for_nothing_and_a_discount_makes_later_rewards_small(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    env = HandEnv("Reach", timestep=0.003)
    env.reset(seed=3)
    for discount in (1.0, 0.25):
        settings = QUICK.model_copy(update={"samples": 2, "discount": discount})
        rollouts = Rollouts("Reach", EnvSettings(timestep=0.003), settings, threads=1)
        stepped: list[list[int]] = []
        failing = iter([[False, False], [True, False], [False, False], [False, False]])

        def outcome(*_: Any, failing: Any = failing) -> Any:
            return StepOutcome(np.ones(2), np.array(next(failing)), np.zeros(2, bool), {}), None

        def step(action: Any, rows: Any, stepped: list[list[int]] = stepped) -> None:
            stepped.append([0, 1] if rows is None else rows.tolist())

        monkeypatch.setattr(rollouts.engine, "outcome", outcome)
        monkeypatch.setattr(rollouts.engine, "step", step)
        found = rollouts(env.save_state(), np.zeros((3, 2, 16)), 1)
        worth = discount ** (0.039 * np.arange(4))
        np.testing.assert_allclose(found, [worth[:2].sum(), worth.sum()])
        assert stepped == [[0, 1], [0, 1], [1], [1]]  # What has failed takes no time any more.


def test_failing_at_once_does_not_save_the_costs_of_failing_later(monkeypatch: pytest.MonkeyPatch) -> None:
    env = HandEnv("Reach", timestep=0.003)
    env.reset(seed=3)
    rollouts = Rollouts("Reach", EnvSettings(timestep=0.003), QUICK.model_copy(update={"samples": 3}), threads=1)
    rewards = iter([[-20.0, -2.0, -1.0], [0.0, -20.0, -3.0], [0.0, 0.0, -4.0]])
    failed = iter([[True, False, False], [False, True, False], [False, False, False]])

    def outcome(*_: Any) -> Any:
        return StepOutcome(np.array(next(rewards)), np.array(next(failed)), np.zeros(3, bool), {}), None

    monkeypatch.setattr(rollouts.engine, "outcome", outcome)
    monkeypatch.setattr(rollouts.engine, "step", lambda action, rows: None)
    # What has failed pays as the worst of those that went on in the decision: 20 of the second, and then 4.
    np.testing.assert_array_equal(rollouts(env.save_state(), np.zeros((3, 3, 16)), 0), [-44.0, -26.0, -8.0])


def test_an_episode_reports_what_became_of_it() -> None:
    seen: list[Any] = []
    (found,) = run_episodes(
        "Rotate", EnvSettings(timestep=0.003, decimation=20, objects=("cube",)), QUICK, 1, seconds=0.3, threads=1,
        advance=lambda done, of: seen.append((done, of)),
    )  # fmt: skip
    assert seen == [(k, 5) for k in range(1, 6)]
    assert found.object == "cube"
    assert found.kept
    assert not found.success
    assert 0.5 < found.by_tips <= 1.0
    assert found.thinking > 0.0
    (reached,) = run_episodes("Reach", EnvSettings(timestep=0.003), QUICK, 1, seconds=0.1, threads=1)
    assert math.isnan(reached.count)
    assert math.isnan(reached.by_tips)


def test_the_rest_of_the_last_plan_is_tried_action_by_action(monkeypatch: pytest.MonkeyPatch) -> None:
    mpc = SamplingMpc("Reach", EnvSettings(timestep=0.003), QUICK.model_copy(update={"every": 2}), threads=1)
    env = HandEnv("Reach", timestep=0.003)
    env.reset(seed=3)
    tried: list[Any] = []

    def returns(state: Any, actions: Any, still: int) -> Any:
        tried.append(actions)
        return -np.arange(float(actions.shape[1]))  # The first is the best.

    returns.begin = mpc._rollouts.begin  # type: ignore[attr-defined]
    monkeypatch.setattr(mpc, "_rollouts", returns)
    mpc._rest = np.random.default_rng(0).uniform(-1.0, 1.0, (mpc.decisions, 16))  # Of no spline.
    rest = mpc._rest.astype(np.float32)
    taken = [mpc.plan(env.save_state()) for _ in range(3)]
    np.testing.assert_array_equal(taken, rest[:3])
    np.testing.assert_array_equal(tried[-1][:-2, 0], rest[2:])
    np.testing.assert_array_equal(tried[-1][-2:, 0], 0.0)


def test_a_device_has_no_states_to_plan_from() -> None:
    pytest.importorskip("mujoco_warp", reason="mujoco_warp is not installed: pip install 'allegro-twin[warp]'")
    with pytest.raises(ConfigError, match="states are not saved there"):
        HandEnv("Reach", device="warp:cpu").save_state()


def test_every_decision_tries_the_plan_no_action_the_last_action_held_and_the_best_of_before() -> None:
    settings = QUICK.model_copy(update={"keep": 2, "samples": 12})
    mpc = SamplingMpc("Reach", EnvSettings(timestep=0.003), settings, threads=1)
    env = HandEnv("Reach", timestep=0.003)
    env.reset(seed=3)
    first = mpc.plan(env.save_state())
    tried = mpc._draw(NO_STEPS)
    assert tried.shape == (12, 2, 16)
    np.testing.assert_array_equal(tried[0], mpc._mean)
    np.testing.assert_array_equal(tried[1], 0.0)
    np.testing.assert_array_equal(tried[2], np.stack([first, first]))
    np.testing.assert_array_equal(tried[3:5], mpc._kept)
    assert len(mpc._kept) == 2
    assert len({row.tobytes() for row in tried}) == 12


def test_some_samples_move_one_finger_alone_and_some_begin_afresh() -> None:
    settings = QUICK.model_copy(update={"samples": 40, "fingers": 1.0, "afresh": 0.0})
    mpc = SamplingMpc("Reach", EnvSettings(timestep=0.003), settings, threads=1)
    mpc._mean[...] = 0.3
    moved = (mpc._draw(NO_STEPS)[3:] != 0.3).any(axis=1).reshape(-1, 4, 4).any(axis=-1)  # Four joints a finger.
    assert (moved.sum(axis=-1) == 1).all()
    assert moved.any(axis=0).all()
    mpc.settings = settings.model_copy(update={"afresh": 1.0})
    assert (mpc._draw(NO_STEPS)[3:] == 0.0).sum() >= 37 * 2 * 12


def test_samples_are_spread_between_the_narrowest_and_the_widest() -> None:
    settings = MpcSettings(samples=400, horizon=0.3, knots=2, method="predictive", narrowest=0.02, spread=0.32)
    mpc = SamplingMpc("Reach", EnvSettings(timestep=0.003), settings, threads=1)
    spread = mpc._draw(NO_STEPS)[3:].std(axis=(1, 2))
    np.testing.assert_allclose(np.quantile(spread, [0.05, 0.5, 0.95]), [0.023, 0.08, 0.28], rtol=0.15)
    mpc.settings = settings.model_copy(update={"narrowest": 0.32})
    np.testing.assert_allclose(mpc._draw(NO_STEPS)[3:].std(axis=(1, 2)), 0.32, rtol=0.5)


def test_some_samples_bring_one_finger_back_to_its_beginning() -> None:
    environment = EnvSettings(objects=("cube",), timestep=0.003)
    settings = MpcSettings(samples=16, horizon=0.39, hold=0.0, knots=10, back=True, afresh=1.0, spread=1e-9)
    mpc = SamplingMpc("Rotate", environment, settings.model_copy(update={"narrowest": 1e-9}), threads=1)
    env = HandEnv("Rotate", objects=("cube",), timestep=0.003)
    env.reset(seed=3)
    begun = np.array(env.engine.memory.end[0])
    mpc._rollouts.begin(env.save_state())
    rng = np.random.default_rng(0)
    for _ in range(3):
        env.step(rng.uniform(-1.0, 1.0, 16).astype(np.float32))
    back = mpc._steps_back(env.save_state())
    tried = mpc._draw(back)
    np.testing.assert_array_equal(tried[3:7], back)
    steps = [set(np.flatnonzero((np.abs(row) > 1e-6).any(axis=0)) // 4) for row in tried[7:]]
    assert {len(fingers) for fingers in steps} == {0, 1}  # Around no action, or around a finger's way back.
    for finger in range(4):
        for action in mpc._spline(back[finger][None])[:5, 0]:
            env.step(action.astype(np.float32))
    np.testing.assert_allclose(env.engine.memory.end[0], begun, atol=1e-6)


def test_ways_back_are_for_actions_that_change_set_points() -> None:
    settings = QUICK.model_copy(update={"back": True})
    mpc = SamplingMpc("Reach", EnvSettings(timestep=0.003, control="torque"), settings, threads=1)
    env = HandEnv("Reach", timestep=0.003, control="torque")
    env.reset(seed=3)
    with pytest.raises(ConfigError, match="back is for control delta, not torque: leave it out"):
        mpc.plan(env.save_state())


def test_a_cost_grows_towards_the_ends_of_joints_with_effort_and_as_an_object_leaves_its_place(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def cost(**weights: float) -> Any:
        settings = MpcSettings(samples=3, costs=CostSettings(**weights))
        environment = EnvSettings(timestep=0.003, objects=("cube",))
        rollouts = Rollouts("Rotate", environment, settings, threads=1)
        env = HandEnv("Rotate", timestep=0.003, objects=("cube",))
        env.reset(seed=1)
        rollouts.begin(env.save_state())
        worlds, thing = rollouts.engine.worlds, rollouts.engine.task.object_body
        spec = rollouts.engine.task.spec
        assert thing is not None
        worlds.position[...] = (spec.lower + spec.upper) / 2
        rollouts.costs._posture = (spec.lower + spec.upper) / 2
        worlds.control[...] = 0.0
        span = spec.upper - spec.lower
        worlds.position[1, 5] = spec.upper[5] - 0.05 * span[5]
        worlds.position[2, 5] = spec.upper[5]
        worlds.control[1, 2], worlds.control[2, :] = spec.actuation.torque_limit[2], -spec.actuation.torque_limit
        thing.pose[1, 2] -= 0.01
        thing.pose[2, 0] += 0.02
        return rollouts.costs()

    np.testing.assert_allclose(cost(ends=2.0), [0.0, 2.0 * 0.25, 2.0])
    np.testing.assert_allclose(cost(posture=1.0), [0.0, 0.45**2, 0.25])
    np.testing.assert_allclose(cost(effort=1.0), [0.0, 1 / 16, 1.0])
    np.testing.assert_allclose(cost(place=4.0), [0.0, 1.0, 4.0], atol=1e-12)
    np.testing.assert_allclose(cost(grip=3.0), 3.0)  # Before a step nothing touches.
    monkeypatch.setattr(LinkContacts, "touching", lambda *_: np.array([4, 3, 2]))
    np.testing.assert_allclose(cost(grip=1.0), [0.0, 1 / 16, 1 / 4])
    np.testing.assert_allclose(cost(), 0.0)


def test_leaning_costs_whatever_side_of_the_object_was_up() -> None:
    costs = Rollouts("Rotate", EnvSettings(objects=("cube",)), MpcSettings(samples=2), threads=1).costs
    costs.settings = CostSettings(lean=1.0)
    thing = costs._engine.task.object_body
    assert thing is not None
    on_side = np.array([np.cos(np.pi / 4), np.sin(np.pi / 4), 0.0, 0.0])
    costs.begin(np.zeros(16), np.concatenate([np.zeros(3), on_side]))
    thing.pose[0, 3:] = quaternion_product(np.array([0.6, 0.0, 0.0, 0.8]), on_side)  # Turned about the vertical.
    thing.pose[1, 3:] = [1.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(costs(), [0.0, 1.0], atol=1e-12)


def test_costs_of_an_object_are_refused_where_there_is_none() -> None:
    with pytest.raises(ConfigError, match="costs.place is for tasks with an object, and Reach has none"):
        Rollouts("Reach", EnvSettings(), MpcSettings(samples=2, costs=CostSettings(place=1.0)), threads=1)
    with pytest.raises(ConfigError, match="Lift does not tell what touches"):
        Rollouts("Lift", EnvSettings(), MpcSettings(samples=2, costs=CostSettings(grip=1.0)), threads=1)


def test_the_planner_may_step_more_coarsely_than_the_episode() -> None:
    environment = EnvSettings(decimation=20, objects=("cube",), timestep=0.001)
    coarser = planner_environment(environment, MpcSettings(stride=2, coarse=True))
    assert (coarser.period, coarser.timestep, coarser.decimation, coarser.coarse) == (0.006, 0.006, 10, True)
    assert planner_environment(environment, MpcSettings()).timestep == environment.period
    assert planner_environment(environment, MpcSettings(stride=0)) == environment
    soft = planner_environment(EnvSettings(hand="qb_softhand"), MpcSettings())
    assert (soft.period, soft.timestep) == (0.003, 0.0015)  # Its fingers shake in longer steps.
    uneven = planner_environment(EnvSettings(), MpcSettings(stride=2))  # 13 control periods are 6 steps.
    assert uneven.decimation == 6
    assert uneven.timestep == pytest.approx(0.0065)
    with pytest.raises(ConfigError, match="Lift has a script, which goes by control periods"):
        Rollouts("Lift", EnvSettings(decimation=14), MpcSettings(samples=2, stride=2), threads=1)
    env = HandEnv("Rotate", objects=("cube",), timestep=0.003, decimation=20)
    env.reset(seed=0)
    env.step(np.zeros(16, np.float32))
    rollouts = Rollouts("Rotate", environment, MpcSettings(samples=2, stride=2), threads=1)
    rollouts.begin(env.save_state())
    assert rollouts.engine.memory.tick.tolist() == [10, 10]
    np.testing.assert_array_equal(rollouts.engine.worlds.position[1], env.engine.worlds.position[0])


def test_settings_of_tasks_ship() -> None:
    assert planner_settings("Rotate") != MpcSettings() != planner_settings("Reorient")
    assert planner_settings("HoldDisturbed") == MpcSettings()


def test_plans_in_real_time_have_settings_of_their_own_where_a_task_has_them() -> None:
    def steps(chosen: MpcSettings) -> float:
        """Physics steps of a plan, of all its samples."""
        return chosen.samples * chosen.iterations * (chosen.horizon + chosen.hold) / max(chosen.stride, 1)

    for task in ("Rotate", "Reorient"):
        assert steps(planner_settings(task, real_time=True)) < 0.3 * steps(planner_settings(task))
    assert planner_settings("HoldDisturbed", real_time=True) == MpcSettings()


def test_a_decided_action_is_that_of_every_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    mpc = SamplingMpc("Reach", EnvSettings(timestep=0.003), QUICK, threads=1)
    env = HandEnv("Reach", timestep=0.003)
    env.reset(seed=3)
    seen: list[Any] = []
    monkeypatch.setattr(mpc, "_rollouts", _Recorded(mpc._rollouts, seen))
    decided = np.linspace(-0.5, 0.5, 16)
    plan = mpc.search(env.save_state(), decided)
    np.testing.assert_allclose(plan.actions[0], decided, atol=1e-7)
    np.testing.assert_allclose(seen[0][0], np.tile(decided, (12, 1)), atol=1e-7)


def test_the_plan_is_the_best_of_all_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    mpc = SamplingMpc("Reach", EnvSettings(timestep=0.003), QUICK.model_copy(update={"iterations": 2}), threads=1)
    env = HandEnv("Reach", timestep=0.003)
    env.reset(seed=3)
    tried: list[Any] = []
    worth = iter([np.arange(12.0), np.arange(12.0) - 5.0])

    def returns(state: Any, actions: Any, still: int) -> Any:
        tried.append(actions)
        return next(worth)

    returns.begin = mpc._rollouts.begin  # type: ignore[attr-defined]
    monkeypatch.setattr(mpc, "_rollouts", returns)
    plan = mpc.search(env.save_state())
    assert plan.value == 11.0
    np.testing.assert_array_equal(plan.actions, tried[0][:, 11].astype(np.float32))


def test_what_a_task_counts_is_paid_as_it_grows(monkeypatch: pytest.MonkeyPatch) -> None:
    keywords: dict[str, Any] = {"objects": ("cube",), "timestep": 0.003}
    env = HandEnv("Rotate", **keywords)
    env.reset(seed=3)
    settings = QUICK.model_copy(update={"samples": 2, "reward": 0.0, "count": 2.0, "discount": 0.5})
    rollouts = Rollouts("Rotate", EnvSettings(**keywords), settings, threads=1)
    counts = iter([[0.1, 0.0], [0.3, 0.0], [0.2, 1.0]])

    def outcome(*_: Any) -> Any:
        return StepOutcome(np.ones(2), np.zeros(2, bool), np.zeros(2, bool), {"turned": np.array(next(counts))}), None

    monkeypatch.setattr(rollouts.engine, "outcome", outcome)
    worth = 0.5 ** (0.039 * np.arange(3))
    found = rollouts(env.save_state(), np.zeros((3, 2, 16)), 0)
    np.testing.assert_allclose(found, [2.0 * (worth @ [0.1, 0.2, -0.1]), 2.0 * worth[2]])
    with pytest.raises(ConfigError, match="Reach counts nothing: leave it out"):
        Rollouts("Reach", EnvSettings(), settings, threads=1)


@pytest.mark.parametrize(
    ("given", "key"),
    [
        ({"terms": {"angel": 8.0}}, "terms.angel: no term named 'angel'; did you mean 'angle'"),
        ({"stride": 2}, "stride: Lift has a script"),
        ({"stride": 0, "costs": CostSettings(grip=1.0)}, "costs.grip is for objects in the fingertips"),
    ],
)
def test_settings_that_a_task_cannot_have_are_named_with_the_place_where_they_are_written(
    given: dict[str, Any], key: str
) -> None:
    task = "Reorient" if "terms" in given else "Lift"
    with pytest.raises(ConfigError, match=rf"^mine.yaml: {re.escape(key)}"):
        SamplingMpc(
            task, EnvSettings(timestep=0.003), MpcSettings(samples=2).model_copy(update=given), 1, "mine.yaml: "
        )


def test_terms_that_a_task_reports_cost_by_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    keywords: dict[str, Any] = {"objects": ("cube",), "timestep": 0.003}
    env = HandEnv("Reorient", **keywords)
    env.reset(seed=3)
    settings = QUICK.model_copy(update={"samples": 2, "reward": 0.0, "terms": {"angle": 5.0}})
    rollouts = Rollouts("Reorient", EnvSettings(**keywords), settings, threads=1)
    angles = iter([[1.0, 2.0], [0.5, 2.0]])

    def outcome(*_: Any) -> Any:
        return StepOutcome(np.ones(2), np.zeros(2, bool), np.zeros(2, bool), {"angle": np.array(next(angles))}), None

    monkeypatch.setattr(rollouts.engine, "outcome", outcome)
    found = rollouts(env.save_state(), np.zeros((2, 2, 16)), 0)
    np.testing.assert_allclose(found, [-5.0 * 0.039 * 1.5, -5.0 * 0.039 * 4.0])
    rollouts.settings = settings.model_copy(update={"terms": {"angel": 1.0}})
    angles = iter([[1.0, 2.0]])
    with pytest.raises(ConfigError, match="did you mean 'angle'"):
        rollouts(env.save_state(), np.zeros((2, 2, 16)), 0)


class _Recorded:
    def __init__(self, inner: Any, seen: list[Any]) -> None:
        self._inner, self._seen = inner, seen
        self.begin = inner.begin

    def __call__(self, state: Any, actions: Any, still: int) -> Any:
        self._seen.append(actions)
        return self._inner(state, actions, still)
