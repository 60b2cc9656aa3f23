"""A planner follows a hand by what is measured and observed, in lockstep or beside it."""

from __future__ import annotations

from threading import Event
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.orientation import angle_between_quaternions, quaternion_from_vector, quaternion_product
from allegro_twin.learning.environments.episode import EpisodeBackend
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.mpc.controller import MpcController
from allegro_twin.learning.mpc.observed import ObservedEpisode, PoseTracker
from allegro_twin.learning.mpc.sampling import Plan
from allegro_twin.learning.mpc.settings import MpcSettings, PoseCamera
from allegro_twin.loop import run, until
from allegro_twin.types import Array

TINY = MpcSettings(samples=4, horizon=0.12, hold=0.0, knots=2, iterations=1, method="predictive", stride=2)
CUBE = EnvSettings(objects=("cube",), decimation=20, timestep=0.003)
EXACT = PoseCamera(period=0.003, window=0.003)


class Flight:
    """An object that flies and turns steadily."""

    def __init__(self) -> None:
        self.t = 0.0
        self.velocity, self.spin = np.array([0.1, -0.2, 0.3]), np.array([0.4, 0.0, -1.0])

    def at(self, t: float) -> Array:
        turn = quaternion_product(np.array([0.6, 0.0, 0.8, 0.0]), quaternion_from_vector(self.spin * t))
        return np.concatenate([self.velocity * t, turn])

    def __call__(self) -> Array:
        return self.at(self.t)


@pytest.mark.parametrize("delay", [0.0, 0.05])
def test_a_pose_is_carried_on_over_the_delay_and_between_pictures(delay: float) -> None:
    flight = Flight()
    tracker = PoseTracker(flight, PoseCamera(period=0.03, delay=delay, window=0.06))
    for tick in range(100):
        flight.t = tick * 0.003
        tracker.look(flight.t)
    pose, motion = tracker.now(flight.t)
    np.testing.assert_allclose(pose[:3], flight.at(flight.t)[:3], atol=1e-9)
    assert angle_between_quaternions(pose[3:], flight.at(flight.t)[3:]) < 2e-3
    np.testing.assert_allclose(motion[:3], flight.velocity, atol=1e-9)
    np.testing.assert_allclose(motion[3:], flight.spin, atol=0.05)
    assert len(tracker._pictures) < 8  # What nobody needs any more is forgotten.


def test_a_picture_arrives_after_its_delay() -> None:
    places = iter([np.zeros(3), np.ones(3)])
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    tracker = PoseTracker(lambda: np.concatenate([next(places), upright]), PoseCamera(period=0.03, delay=0.05))
    tracker.look(0.0)
    tracker.look(0.03)
    np.testing.assert_array_equal(tracker.now(0.079)[0][:3], 0.0)
    assert tracker.now(0.081)[0][0] >= 1.0


def test_the_first_picture_is_all_there_is_and_noise_is_that_of_the_seed() -> None:
    def seen(seed: int, noise: float) -> tuple[Array, Array]:
        tracker = PoseTracker(Flight(), PoseCamera(noise=noise, turn=noise, seed=seed, delay=0.1))
        tracker.look(0.0)
        return tracker.now(0.0)

    np.testing.assert_array_equal(seen(0, 0.0)[0], Flight().at(0.0))
    np.testing.assert_array_equal(seen(0, 0.0)[1], 0.0)
    np.testing.assert_array_equal(seen(1, 0.01)[0], seen(1, 0.01)[0])
    off = np.array([seen(seed, 0.01)[0] - Flight().at(0.0) for seed in range(200)])
    assert off[:, :3].std() == pytest.approx(0.01, rel=0.1)
    turns = [angle_between_quaternions(seen(seed, 0.01)[0][3:], Flight().at(0.0)[3:]) for seed in range(200)]
    assert np.sqrt(np.mean(np.square(turns)) / 3) == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize(("task", "count"), [("Rotate", "turned"), ("Reorient", "reached")])
def test_a_model_of_an_episode_keeps_up_with_it(task: str, count: str) -> None:
    environment = CUBE.model_copy(update={"goals": "yaw"}) if task == "Reorient" else CUBE
    hand = EpisodeBackend(task, environment, seed=2)
    thing = hand.engine.task.object_body
    assert thing is not None
    model = ObservedEpisode(task, environment, 2, PoseTracker(lambda: thing.pose[0], EXACT))
    state = hand.reset()
    model.begin(state)
    np.testing.assert_array_equal(model.engine.task.object_body.pose, thing.pose)  # type: ignore[union-attr]
    if task == "Reorient":  # The first goal is reached at once, and both draw the next.
        hand.engine.task.goal()[0] = model.engine.task.goal()[0] = thing.pose[0, 3:]  # type: ignore[index]
    interface = hand.engine.task.interface
    memory = interface.start(state.position, 0, hand.target)
    rng = np.random.default_rng(0)
    from allegro_twin.types import TorqueCommand

    for _ in range(4):
        action = rng.uniform(-0.3, 0.3, 16)
        memory = interface.act(action, memory)
        set_points = interface.set_points(memory)
        for k in range(interface.decimation):
            hand.write(TorqueCommand(interface.torque(state.position, state.velocity, set_points, k)))
            state = hand.read()
            model.look(state.t)
        memory = interface.advance(memory)
        model.follow(state, action)
        np.testing.assert_array_equal(model.engine.worlds.position[0], state.position)
        np.testing.assert_array_equal(model.engine.worlds.velocity[0], state.velocity)
        np.testing.assert_allclose(model.engine.task.object_body.pose, thing.pose, atol=1e-12)  # type: ignore[union-attr]
        np.testing.assert_allclose(model.engine.memory.end[0], memory.end)
        assert float(getattr(model.engine.task, count)[0]) == pytest.approx(hand.count)
    assert model.engine.count.tolist() == [4]
    assert hand.count > 0 or task == "Rotate"
    if task == "Reorient":
        np.testing.assert_allclose(model.engine.task.goal(), hand.engine.task.goal(), atol=1e-6)  # type: ignore[arg-type]


def test_a_run_in_lockstep_repeats_itself_to_the_bit_and_says_how_many_plans_it_made() -> None:
    hand = EpisodeBackend("Rotate", CUBE, seed=1)
    thing = hand.engine.task.object_body
    assert thing is not None
    model = ObservedEpisode("Rotate", CUBE, 1, PoseTracker(lambda: thing.pose[0], EXACT))
    controller = MpcController("Rotate", model, TINY.model_copy(update={"every": 2}), threads=1)
    first, second = ([s.state.position for s in until(0.25, run(hand, controller))] for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert (np.ptp(first, axis=0) > 0.01).any()
    assert controller.report(0.25) == "mpc: 3 plans in lockstep in 5 decisions, 12.0 a second of the hand"
    controller.close()


def test_beside_a_hand_the_last_plan_goes_on_until_the_next_has_come(monkeypatch: pytest.MonkeyPatch) -> None:
    hand = EpisodeBackend("Reach", EnvSettings(timestep=0.003), seed=1)
    model = ObservedEpisode("Reach", EnvSettings(timestep=0.003), 1)
    controller = MpcController("Reach", model, TINY.model_copy(update={"stride": 1}), real_time=True, threads=1)
    gate, plans, decided, moved = Event(), list[Plan](), list[Any](), list[int]()
    search, move_on = controller._mpc.search, controller._mpc.move_on

    def slow(state: Any, action: Any = None) -> Plan:
        decided.append(action)
        if len(decided) == 2:
            gate.wait(60.0)
        plans.append(search(state, action))
        return plans[-1]

    def note(plan: Plan, decisions: int = 1) -> None:
        moved.append(decisions)
        move_on(plan, decisions)

    monkeypatch.setattr(controller._mpc, "search", slow)
    monkeypatch.setattr(controller._mpc, "move_on", note)
    state = hand.reset()
    memory = controller.start(state)
    taken = [memory.action]
    for _ in range(13 * 5):
        before = controller.decisions
        if before == 0 and controller._pending is not None:
            controller._pending.result()
        command, memory = controller(state, memory)
        hand.write(command)
        state = hand.read()
        if controller.decisions != before:
            taken.append(memory.action)
    gate.set()
    controller.close()
    none = np.zeros(16)
    assert len(plans[0].actions) == 3
    expected = [none, plans[0].actions[1], plans[0].actions[2], none, none]  # Nothing is planned yet; run out.
    np.testing.assert_array_equal(taken[:5], expected)
    np.testing.assert_array_equal(decided[0], none)
    np.testing.assert_array_equal(plans[0].actions[0], none)
    np.testing.assert_array_equal(decided[1], plans[0].actions[1])
    assert moved == [1]
    assert controller.report(0.195) == "mpc: 1 plans beside the hand in 5 decisions, 5.1 a second of the hand"


def test_a_late_plan_moves_on_by_the_decisions_that_have_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    model = ObservedEpisode("Reach", EnvSettings(timestep=0.003), 1)
    controller = MpcController("Reach", model, TINY.model_copy(update={"stride": 1}), real_time=True, threads=1)
    moved: list[int] = []
    monkeypatch.setattr(controller._mpc, "move_on", lambda plan, decisions=1: moved.append(decisions))
    hand = EpisodeBackend("Reach", EnvSettings(timestep=0.003), seed=1)
    controller.start(hand.reset())
    assert controller._pending is not None
    plan = controller._pending.result()
    controller.decisions = 2
    np.testing.assert_array_equal(controller._at_hand(), plan.actions[2])
    controller.close()
    assert moved == [2]


def test_what_a_model_cannot_follow_is_refused() -> None:
    with pytest.raises(ConfigError, match="Rotate has an object, and this hand comes with no pose of one"):
        ObservedEpisode("Rotate", CUBE)
    with pytest.raises(ConfigError, match="Lift has a script"):
        ObservedEpisode("Lift", EnvSettings())


def test_a_goal_may_be_moved_while_the_hand_moves() -> None:
    model = ObservedEpisode("Reach", EnvSettings(timestep=0.003), 1)
    hand = EpisodeBackend("Reach", EnvSettings(timestep=0.003), seed=1)
    state = hand.reset()
    model.begin(state)
    drawn = np.array(model.engine.task.goal())
    model.goal = np.full(12, 0.1)
    model.follow(state, np.zeros(16))
    np.testing.assert_allclose(model.engine.task.goal(), 0.1)  # type: ignore[arg-type]
    assert not np.allclose(drawn, 0.1)
