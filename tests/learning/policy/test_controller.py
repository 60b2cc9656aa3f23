"""A policy does on a hand what it did in training: the same observations, the same torques, to the bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from allegro_twin.control.controllers import PD
from allegro_twin.errors import CommandError, ConfigError
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.policy.card import PolicyCard
from allegro_twin.learning.policy.controller import PolicyController, ZeroPolicy
from allegro_twin.learning.policy.interface import Floats, Interface, Observation
from allegro_twin.learning.policy.script import closing_moves
from allegro_twin.learning.tasks.scripted_closing import ScriptedClosingTask
from allegro_twin.loop import run, until
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.types import HandState


class Swinging:
    """A policy with something to say that keeps what it saw."""

    def __init__(self) -> None:
        self.seen: list[Any] = []
        self.weights = np.random.default_rng(0).normal(size=(64, 16)).astype(np.float32)

    def __call__(self, observation: Observation) -> Floats:
        self.seen.append(observation)
        joints = observation["observation"] if isinstance(observation, dict) else observation
        goal = observation["desired_goal"] if isinstance(observation, dict) else joints
        result: Floats = np.tanh((joints[:64, None] * self.weights).sum(axis=0) + 20 * goal.sum())
        return result


def hand_of(env: HandEnv) -> SimBackend:
    """The same scene as a backend, without the environment."""
    snapshot = env.engine.worlds.snapshot(0)
    posture = env.engine.worlds.position[0].copy()
    return SimBackend(snapshot.spec, snapshot.model, period=env.engine.settings.period, posture=posture)


@pytest.mark.parametrize(("control", "history"), [("delta", 1), ("delta", 3), ("absolute", 1), ("torque", 1)])
def test_a_policy_on_a_backend_repeats_its_episode_in_the_environment(control: str, history: int) -> None:
    env, policy = HandEnv("Reach", control=control, history=history), Swinging()
    observation, _ = env.reset(seed=2)
    assert isinstance(observation, dict)
    goal = observation["desired_goal"].astype(np.float64)
    hand = hand_of(env)
    episode = [observation]
    for _ in range(40):
        episode.append(env.step(policy(episode[-1]))[0])  # type: ignore[arg-type]  # A dictionary, as above.
    deployed = Swinging()
    controller = PolicyController(deployed, env.engine.task.interface, goal)
    for _ in until(40 * env.engine.task.interface.seconds, run(hand, controller)):
        pass
    assert len(deployed.seen) == 41
    for ours, its in zip(episode, deployed.seen, strict=True):
        assert isinstance(ours, dict)
        for name, value in ours.items():
            np.testing.assert_array_equal(its[name], value)
    assert np.ptp([seen["achieved_goal"] for seen in deployed.seen], axis=0).max() > 0.02, "the hand stood still"


@pytest.mark.parametrize("task", ["Grasp", "Lift"])
def test_an_environment_without_action_is_the_scripted_player(task: str) -> None:
    """PD with the library's grasp as its reference, on a backend in the same scene, surrounded by the same events."""
    env = HandEnv(task, objects=("tennis_ball",), position_noise=0.0)
    env.reset(seed=0)
    inner = env.engine.task
    assert isinstance(inner, ScriptedClosingTask)
    scene = inner.scenes[0]
    sim = hand_of(env)
    played = PD(closing_moves(scene.grasp, inner.wait, inner.squeeze), env.engine.task.gains)
    twin = HandEnv(task, objects=("tennis_ball",), position_noise=0.0)
    twin.reset(seed=0)
    state, decimation = sim.reset(), inner.interface.decimation
    sim.data.qpos[:] = env.engine.worlds.snapshot(0).data.qpos
    memory = played.start(state)
    for step in range(60):
        inner.plan_surroundings(np.array([step * decimation]))
        for k in range(decimation):
            inner.move_surroundings(k)  # Writes into the batch what surrounds the hand; the backend gets a copy.
            _copy_surroundings(env, sim)
            command, memory = played(state, memory)
            sim.write(command)
            state = sim.read()
        twin.step(np.zeros(16, np.float32))
        np.testing.assert_array_equal(twin.engine.worlds.position[0], state.position)
    assert twin.engine.count[0] == 60


def _copy_surroundings(env: HandEnv, sim: SimBackend) -> None:
    worlds = env.engine.worlds
    if sim.model.nmocap:
        place, way, holds = worlds.presenter()
        sim.data.mocap_pos[0], sim.data.mocap_quat[0], sim.data.eq_active[0] = place[0], way[0], holds[0]
        thing = env.engine.task.object_body
        assert thing is not None
        sim.data.xfrc_applied[thing.id, :3] = thing.force[0]
    else:
        sim.data.ctrl[sim.model.actuator("wrist_z").id] = worlds.set_point("wrist_z")[0]


def test_decisions_are_not_late_where_the_hand_has_missed_periods() -> None:
    env = HandEnv("Reach")
    interface = env.engine.task.interface
    policy = Swinging()
    controller = PolicyController(policy, interface, np.zeros(12))

    def at(tick: int) -> HandState:
        rest = np.zeros(16)
        return HandState(tick * 0.003, tick, interface.middle, rest, rest, rest, np.zeros(3))

    memory = controller.start(at(0))
    decided = []
    for tick in (0, 5, 12, 14, 25, 27, 60, 65, 66):
        before = len(policy.seen)
        _, memory = controller(at(tick), memory)
        decided.append(len(policy.seen) > before)
    assert decided == [False, False, False, True, False, True, True, True, False]
    assert memory.memory.tick == 65


def test_a_policy_that_answers_with_a_nan_is_stopped() -> None:
    env = HandEnv("Reach")
    env.reset(seed=0)

    def broken(observation: Observation) -> Floats:
        return np.full(16, np.nan, np.float32)

    with pytest.raises(CommandError, match=r"the policy's action at 0\.000 s is not finite"):
        next(run(hand_of(env), PolicyController(broken, env.engine.task.interface, np.zeros(12))))


def test_a_goal_is_given_where_the_policy_takes_one_and_nowhere_else() -> None:
    reach = HandEnv("Reach").engine.task.interface
    with pytest.raises(ConfigError, match="this policy takes a goal of 12 numbers, not 0"):
        PolicyController(ZeroPolicy(16), reach)


def card_and_interface(task: str) -> tuple[PolicyCard, Interface]:
    kwargs: dict[str, Any] = {} if task == "Reach" else {"objects": ("lemon", "apple")}
    inner = HandEnv(task, **kwargs).engine.task
    return inner.card(), inner.interface


@pytest.mark.parametrize("task", ["Reach", "Grasp", "Lift"])
def test_a_card_rebuilds_the_interface_of_its_task(task: str) -> None:
    card, interface = card_and_interface(task)
    rebuilt = PolicyCard.model_validate_json(card.model_dump_json()).interface(interface.spec)
    for name in ("mode", "period", "decimation", "step", "reach", "goal", "n_observation", "n_goal"):
        assert getattr(rebuilt, name) == getattr(interface, name)
    if interface.scripts is not None:
        assert rebuilt.scripts is not None
        np.testing.assert_array_equal(rebuilt.scripts.position, interface.scripts.position)
        assert card.script("tripod_lemon") == 0
        with pytest.raises(
            ConfigError, match="no grasp of this policy named 'tripod_lemno'; did you mean 'tripod_lemon'"
        ):
            card.script("tripod_lemno")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 99}, "this policy is of version 99; this package runs 1: train it anew"),
        ({"side": "left"}, "this policy is for the left hand; this one is the right hand"),
        ({"observation": 70}, "the policy sees 70 numbers and gives 16; this hand's interface has 64 and 16"),
        ({"privileged": 7}, "privileged: 7 of the numbers it sees are not measured by any hand"),
    ],
)
def test_a_card_that_does_not_fit_says_both_sides(change: dict[str, Any], message: str) -> None:
    card, interface = card_and_interface("Reach")
    with pytest.raises(ConfigError, match=message):
        card.model_copy(update=change).interface(interface.spec)
