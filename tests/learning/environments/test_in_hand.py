"""Rotate and Reorient pay for what they ask for, and for nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.kinematics.orientation import (
    angle_between_quaternions,
    matrix_from_quaternion,
    quaternion_from_vector,
    rotate_quaternion,
)
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.settings import NEAREST
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.policy.interface import Observation
from allegro_twin.learning.tasks.base import GoalTask
from allegro_twin.learning.tasks.reorient import REACHED
from allegro_twin.learning.tasks.start_states import StartStates, file_name, load_start_states
from allegro_twin.learning.tasks.vectors import tilt, twist
from allegro_twin.sim.batch.link_contacts import AssumedContacts
from allegro_twin.sim.objects.catalogue import GraspObject, load_object

N = 8
ALOFT = (0.0, 0.0, 0.4)  # m: nothing touches an object there while an action lasts.
STILL = np.zeros((N, 16), np.float32)


def batch(task: str, **more: Any) -> HandVectorEnv:
    env = HandVectorEnv(task, N, autoreset_mode="disabled", timestep=0.003, **{"palm": "allowed"} | more)
    env.reset(seed=3)
    return env


def told(observation: Observation) -> np.ndarray[Any, Any]:
    """What no hand measures."""
    assert not isinstance(observation, dict)
    return observation[:, 64:]


def played(env: HandVectorEnv, steps: int) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Returns until each episode ends or the steps are over, and who failed."""
    total, going = np.zeros(N), np.ones(N, bool)
    for _ in range(steps):
        _, reward, failed, _, _ = env.step(STILL)
        total += np.where(going, reward, 0.0)
        going &= ~failed
    return total, ~going


@pytest.mark.parametrize("side", ["right", "left"])
def test_an_object_stays_in_the_fingertips_where_nobody_acts(side: str) -> None:
    env = batch("Reorient", side=side)
    _, lost = played(env, 50)
    assert not lost.any()
    assert len(np.unique(env.engine.worlds.position[:, 0])) == N


@pytest.mark.parametrize("task", ["Rotate", "Reorient"])
def test_a_throw_never_scores_above_staying(task: str) -> None:
    stays, _ = played(batch(task), 50)
    thrown = batch(task)
    thing = thrown.engine.task.object_body
    assert thing is not None
    thing.pose[:, 2] += 0.058  # Out of the fingers, which would catch it.
    thing.velocity[:] = 0.0, 0.0, 4.0
    thing.spin[:, 2] = 15.0  # As it should turn.
    scored, lost = played(thrown, 50)
    assert lost.all()
    assert (scored < stays - 1.0).all()


def test_turning_counts_upright_only_and_a_full_turn_in_the_hand_is_success() -> None:
    env = HandEnv("Rotate", timestep=0.003, palm="allowed")
    env.reset(seed=0)
    thing = env.engine.task.object_body
    assert thing is not None
    paid, success, turned = [], [], 0.0
    task: Any = env.engine.task
    task.place[0], touched = ALOFT, task.contacts
    task.contacts = AssumedContacts(task.worlds)  # In the air nothing would be success.
    for step in range(1, 34):
        if step == 33:
            task.contacts = touched
        lean = np.radians(28.0) if 10 < step <= 20 else 0.0
        thing.pose[0, :3] = ALOFT
        thing.pose[0, 3:] = rotate_quaternion(quaternion_from_vector((0.0, lean, 0.0)), (0.0, 0.0, step * 0.21))
        thing.velocity[0] = thing.spin[0] = 0.0
        _, _, failed, _, info = env.step(np.zeros(16, np.float32))
        assert not failed
        paid.append(info["speed"])
        success.append(info["is_success"])
        turned = info["turned"]
    assert min(paid[1:9]) > 0.5
    assert max(np.abs(paid[11:18])) == 0.0
    assert turned == pytest.approx(33 * 0.21, abs=0.5)
    assert success[-2:] == [True, False]
    assert not any(success[:20])


def test_rocking_to_and_fro_earns_nothing() -> None:
    """Forth while upright, and back while it leans so far that turning is not paid: an evolved gait found that."""
    env = HandEnv("Rotate", timestep=0.003, palm="allowed")
    env.reset(seed=0)
    thing = env.engine.task.object_body
    assert thing is not None
    env.engine.task.place[0] = ALOFT  # type: ignore[attr-defined]  # Of tasks in the hand.
    paid, turned = 0.0, 0.0
    for step in range(40):
        forth = step % 10 < 5
        part = step % 5 / 5.0
        yaw = 0.1 * part if forth else 0.1 * (1.0 - part)
        thing.pose[0, :3] = ALOFT
        lean = quaternion_from_vector((0.0, 0.0 if forth else np.radians(28.0), 0.0))
        thing.pose[0, 3:] = rotate_quaternion(lean, (0.0, 0.0, yaw))
        thing.velocity[0] = thing.spin[0] = 0.0
        _, _, _, _, info = env.step(np.zeros(16, np.float32))
        paid += info["speed"]
        turned = info["turned"]
    assert abs(turned) < 0.3
    assert paid < 1.0


def test_turning_the_same_way_again_after_a_flick_back_earns_nothing() -> None:
    env = HandEnv("Rotate", timestep=0.003, palm="allowed")
    env.reset(seed=0)
    thing = env.engine.task.object_body
    assert thing is not None
    env.engine.task.place[0] = ALOFT  # type: ignore[attr-defined]  # Of tasks in the hand.
    paid = 0.0
    for step in range(40):
        thing.pose[0, :3] = ALOFT
        thing.pose[0, 3:] = quaternion_from_vector((0.0, 0.0, 0.02 * (step % 10)))
        thing.velocity[0] = thing.spin[0] = 0.0
        paid += env.step(np.zeros(16, np.float32))[4]["speed"]
    assert paid < 9.0
    assert paid < 0.2 / 0.039 / 0.6 + 1.0  # What the first time is worth.
    thing.pose[0, :3] = ALOFT
    thing.pose[0, 3:] = quaternion_from_vector((0.0, 0.0, 1.5))
    thing.velocity[0] = thing.spin[0] = 0.0
    assert env.step(np.zeros(16, np.float32))[4]["speed"] == pytest.approx(1.0)  # However fast.


def test_with_back_a_turn_back_costs_at_once_what_the_same_turn_forward_is_paid() -> None:
    env = HandEnv("Rotate", timestep=0.003, palm="allowed", reward={"back": 1.0})
    env.reset(seed=0)
    thing = env.engine.task.object_body
    assert thing is not None
    env.engine.task.place[0] = ALOFT  # type: ignore[attr-defined]  # Of tasks in the hand.
    upright, leaning = 0.0, np.radians(28.0)
    worth = 0.01 / env.engine.task.interface.seconds / 0.6  # Of 0.01 rad.
    course = [  # Heading, lean, and what is paid.
        (1.00, upright, None),  # From wherever it was; farther than ever.
        (1.01, upright, worth),
        (1.02, upright, worth),
        (1.01, upright, -worth),
        (1.00, upright, -worth),
        (1.01, upright, worth),  # Forward again, up to where it was.
        (1.00, leaning, -worth),
        (1.01, leaning, 0.0),
        (1.90, upright, 1.0),  # However fast.
        (1.00, upright, -90 * worth),
    ]
    for heading, lean, expected in course:
        thing.pose[0, :3] = ALOFT
        thing.pose[0, 3:] = rotate_quaternion(quaternion_from_vector((0.0, lean, 0.0)), (0.0, 0.0, heading))
        thing.velocity[0] = thing.spin[0] = 0.0
        _, reward, _, _, info = env.step(np.zeros(16, np.float32))
        paid = reward - sum(info[name] for name in ("slide", "posture", "torque", "work", "dropped"))
        assert expected is None or paid == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("end", [0, -1])
def test_the_smallest_and_the_largest_size_are_drawn_from_their_own_end(end: int) -> None:
    env = HandEnv("Rotate", timestep=0.003, palm="allowed")
    env.reset(seed=0)
    sizes = env.engine.task._held[0].size  # type: ignore[attr-defined]  # Of tasks in the hand.
    for seed in range(12):
        _, info = env.reset(seed=seed, options={"size": float(sizes[end])})
        assert info["randomised"]["size"] == pytest.approx(sizes[end], abs=0.02)


def test_a_toppled_object_ends_the_episode_as_a_failure() -> None:
    env = HandEnv("Rotate", timestep=0.003, palm="allowed")
    env.reset(seed=0)
    thing = env.engine.task.object_body
    assert thing is not None
    thing.pose[0, 3:] = quaternion_from_vector((np.radians(80.0), 0.0, 0.0))
    _, reward, failed, _, info = env.step(np.zeros(16, np.float32))
    assert failed
    assert not info["is_success"]
    assert reward < -15.0


@pytest.mark.parametrize("goals", ["any", "yaw"])
def test_no_goal_is_reached_at_the_beginning_and_each_that_is_brings_another(goals: str) -> None:
    env = batch("Reorient", goals=goals)
    seen, _ = env.reset(seed=0)
    assert isinstance(seen, dict)
    first = np.array(seen["desired_goal"], float)
    assert (angle_between_quaternions(first, np.array(seen["achieved_goal"], float)) > NEAREST - 0.01).all()
    task: Any = env.engine.task
    thing = task.object_body
    task.contacts = AssumedContacts(task.worlds)  # In the air a goal would not count.
    task.place[:] = ALOFT
    thing.pose[:, :3], thing.pose[:, 3:] = ALOFT, first
    thing.velocity[:] = thing.spin[:] = 0.0
    seen, reward, _, _, info = env.step(STILL)
    assert isinstance(seen, dict)
    np.testing.assert_array_equal(seen["desired_goal"], first.astype(np.float32))
    apart = angle_between_quaternions(first, np.array(seen["achieved_goal"], float))
    assert (info["reached"] == 1).all()
    assert (apart < REACHED).all()
    assert (reward > 10.0).all()
    now = np.array(thing.pose[:, 3:])
    seen, _, _, _, _ = env.step(STILL)
    assert isinstance(seen, dict)
    other = angle_between_quaternions(np.array(seen["desired_goal"], float), first)
    assert (other > 0.2).all()
    if goals == "yaw":
        turn = angle_between_quaternions(now, np.array(seen["desired_goal"], float))
        assert (turn < np.pi / 2 + 1e-6).all()
        assert np.abs(tilt(np.array(seen["desired_goal"], float))).max() < 1e-6


def test_a_goal_from_outside_is_judged_as_any_other_and_may_be_given_up_for_the_tasks_own() -> None:
    env = batch("Reorient")
    env.reset(seed=0)
    task = env.engine.task
    assert task.object_body is not None
    task._renewed[0] = True  # type: ignore[attr-defined]  # Of Reorient: the last was reached just now.
    here = task.object_body.pose[0, 3:].copy()
    others = np.array(task.goal())[1:]
    task.set_goal(0, here)
    _, _, _, _, info = env.step(STILL)
    np.testing.assert_array_equal(np.array(task.goal())[0], here.astype(np.float32))
    np.testing.assert_array_equal(np.array(task.goal())[1:], others)
    assert info["reached"].tolist() == [1.0] + [0.0] * (env.num_envs - 1)
    away = rotate_quaternion(here, np.array([0.0, 0.0, 2.0]))
    task.set_goal(0, away)
    env.step(STILL)
    np.testing.assert_array_equal(np.array(task.goal())[0], away.astype(np.float32))
    task.set_goal(0, None)
    env.step(STILL)
    assert angle_between_quaternions(np.array(task.goal(), float)[0], away) > 0.01


def test_a_task_without_such_goals_takes_none_from_outside() -> None:
    with pytest.raises(ConfigError, match="Rotate takes no goal from outside; Reorient and Reach do"):
        batch("Rotate").engine.task.set_goal(0, np.array([1.0, 0.0, 0.0, 0.0]))


def test_a_yaw_to_reach_is_upright_however_the_object_leans() -> None:
    env = batch("Reorient", goals="yaw")
    env.reset(seed=0)
    task = env.engine.task
    assert task.object_body is not None
    task.object_body.pose[:, 3:] = rotate_quaternion(task.object_body.pose[:, 3:], np.array([0.3, 0.1, 0.0]))
    assert tilt(task.object_body.pose[:, 3:]).min() > 0.2
    task._draw_goals(np.arange(env.num_envs))  # type: ignore[attr-defined]  # Of Reorient.
    goals = np.array(task.goal(), float)
    assert tilt(goals).max() < 1e-6
    away = np.abs((twist(goals) - twist(task.object_body.pose[:, 3:]) + np.pi) % (2 * np.pi) - np.pi)
    assert (away > NEAREST - 1e-6).all()
    assert (away < np.pi / 2 + 1e-6).all()


def test_to_wait_beside_a_goal_for_ten_seconds_is_worth_less_than_to_reach_it() -> None:
    for decimation in (5, 20):
        task = batch("Reorient", decimation=decimation).engine.task
        assert isinstance(task, GoalTask)
        goal = np.array([[1.0, 0.0, 0.0, 0.0]])
        beside = rotate_quaternion(goal, np.array([[0.0, 0.0, REACHED + 0.001]]))
        waiting, there = (float(task.reward(where, goal, np.zeros(1))[0]) for where in (beside, goal))
        assert 10.0 / (0.003 * decimation) * waiting < there


def test_goals_are_no_farther_than_they_are_asked_to_be() -> None:
    seen, _ = batch("Reorient", farthest=0.5).reset(seed=5)
    assert isinstance(seen, dict)
    apart = angle_between_quaternions(*(np.array(seen[f"{what}_goal"], float) for what in ("achieved", "desired")))
    assert apart.max() < 0.5 + 1e-5


@pytest.mark.parametrize("farthest", [0.1, 6.5])
def test_goals_that_are_reached_already_or_beyond_half_a_turn_are_refused(farthest: float) -> None:
    with pytest.raises(ConfigError, match=rf"farthest: input should be (greater|less) than .*, not {farthest}"):
        HandEnv("Reorient", farthest=farthest)


@pytest.mark.parametrize("goals", ["any", "yaw"])
@pytest.mark.parametrize("farthest", [0.3, np.pi])
def test_no_goal_is_within_reach_when_it_is_drawn(goals: str, farthest: float) -> None:
    env = HandVectorEnv("Reorient", 200, goals=goals, farthest=farthest, timestep=0.003)
    seen, _ = env.reset(seed=5)
    assert isinstance(seen, dict)
    away = angle_between_quaternions(seen["achieved_goal"], seen["desired_goal"])
    assert away.min() > 0.29 > REACHED


def in_the_palm(env: HandVectorEnv) -> np.ndarray[Any, Any]:
    """The object's pose in the palm's frame: position, m, and rotation matrix, (n, 3, 4)."""
    worlds, thing = env.engine.worlds, env.engine.task.object_body
    assert thing is not None
    palm = worlds.model.body("palm_link").id
    lean = matrix_from_quaternion(worlds.expand("body_quat")[:, palm])
    away = thing.pose[:, :3] - worlds.model.body_pos[palm]
    turned = np.concatenate([away[..., None], matrix_from_quaternion(thing.pose[:, 3:])], axis=-1)
    found: np.ndarray[Any, Any] = np.swapaxes(lean, 1, 2) @ turned
    return found


@pytest.mark.parametrize(("task", "keywords"), [
    ("Rotate", {"grip": "pinch"}), ("Reorient", {"grip": "cradle", "side": "left"}), ("Reorient", {"palm": "allowed"}),
    ("HoldDisturbed", {"objects": ("lemon",)}),
])  # fmt: skip
def test_where_the_palm_leans_an_episode_begins_with_the_same_grasp(task: str, keywords: dict[str, Any]) -> None:
    upright, leaning = (
        HandVectorEnv(task, N, timestep=0.003, randomise={"wrist_tilt": (tilted, tilted)}, **keywords)
        for tilted in (0.0, 0.3)
    )
    for env in (upright, leaning):
        env.reset(seed=3)
    np.testing.assert_allclose(in_the_palm(leaning), in_the_palm(upright), atol=1e-12)
    things: list[Any] = [env.engine.task.object_body for env in (upright, leaning)]
    turned = angle_between_quaternions(*(thing.pose[:, 3:] for thing in things))
    np.testing.assert_allclose(turned, 0.3 * np.sqrt(3.0), rtol=1e-9)  # rad: a rotation vector of 0.3 each.
    assert not leaning.step(STILL)[2].any()


def test_a_palm_that_leans_by_its_file_begins_with_the_same_grasp(tmp_path: Path) -> None:
    file = tmp_path / "leaning.yaml"
    interval = {"torque_constant": [0.0] * 16, "delay": [0.0]}
    file.write_text(yaml.safe_dump({
        "wire": {"version": "v4", "side": "right", "torque_constant": [1.0] * 16, "encoder_offset": [0] * 16},
        "drive": {"tilt": [0.0, 0.2, 0.1]}, "identified": {"interval": interval},
    }))  # fmt: skip
    plain, leaning = (
        HandVectorEnv("Rotate", N, timestep=0.003),
        HandVectorEnv("Rotate", N, timestep=0.003, randomise={"twin": str(file)}),
    )
    for env in (plain, leaning):
        env.reset(seed=3)
    np.testing.assert_allclose(in_the_palm(leaning), in_the_palm(plain), atol=1e-12)


def test_a_camera_sees_an_object_late_and_with_noise() -> None:
    exact = batch("Rotate")
    late = batch("Rotate", randomise={"camera_delay": (1, 1)})
    noisy = batch("Rotate", randomise={"camera_shift": (0.004, 0.004)})
    rows = [[told(env.reset(seed=9)[0])] + [told(env.step(STILL)[0]) for _ in range(3)] for env in (exact, late, noisy)]
    for k in range(3):
        np.testing.assert_array_equal(rows[1][k + 1], rows[0][k])
        off = rows[2][k][:, :3] - rows[0][k][:, :3]
        assert 0.0 < np.abs(off).max() <= 0.004 / 0.05 + 1e-6


def test_a_hand_alone_sees_no_object() -> None:
    env = batch("Rotate", observation="hand")
    assert told(env.reset(seed=0)[0]).shape == (N, 0)
    assert env.engine.task.card().privileged == 0
    assert batch("Rotate").engine.task.card().privileged == 13


def test_a_wanted_size_is_begun_with_and_one_that_nobody_has_tried_is_refused() -> None:
    env = HandEnv("Rotate")
    _, info = env.reset(seed=0, options={"size": 1.06})
    assert info["randomised"]["size"] == pytest.approx(1.06, abs=0.01)
    with pytest.raises(ConfigError, match=r"size 1\.4: start states have .* at 0\.9 to 1\.1 times its size"):
        env.reset(seed=0, options={"size": 1.4})


def test_the_package_brings_the_states_that_its_search_would_find() -> None:
    cube = load_object("rubiks_cube")
    assert (data_root() / "conf" / "starts" / file_name(cube)).is_file()
    right, left = (load_start_states(cube, side) for side in ("right", "left"))
    assert isinstance(right, StartStates)
    assert len(right.size) >= 1000
    assert tilt(right.pose[:, 3:]).max() < np.radians(8.0)
    np.testing.assert_array_equal(right.pose[:, 1], -left.pose[:, 1])


@pytest.mark.slow
def test_an_object_that_fingertips_cannot_hold_is_said_to_be_so(monkeypatch: pytest.MonkeyPatch) -> None:
    from allegro_twin.learning.tasks import start_states as module

    monkeypatch.setattr(module, "HOPELESS", 1)
    thing = GraspObject("anvil", "box", (0.057, 0.057, 0.057), 25.0)
    with pytest.raises(
        ConfigError, match="no grasp of the fingertips of allegro was found that holds anvil above the palm"
    ):
        module.search_start_states(thing, module.ANYHOW, module.ALL._replace(most=1))


def test_a_goal_counts_only_while_the_hand_touches_the_object() -> None:
    envs = HandVectorEnv("Reorient", 2, timestep=0.003)
    envs.reset(seed=0)
    task: Any = envs.engine.task
    task.place[1] = task.object_body.pose[1, :3] = ALOFT  # It falls.
    for row in range(2):
        task.set_goal(row, task.object_body.pose[row, 3:].copy())
    _, reward, _, _, info = envs.step(np.zeros((2, 16), np.float32))
    assert info["angle"].max() < 0.1
    assert info["reached"].tolist() == [1.0, 0.0]
    assert info["held"].tolist() == [1.0, 0.0]
    assert info["bonus"].tolist() == [10.0, 0.0]
    assert info["is_success"].tolist() == [True, False]
    assert reward[1] < 0.1
    task.place[0] = task.object_body.pose[0, :3] = ALOFT
    task.object_body.velocity[0] = 0.0
    _, _, _, _, info = envs.step(np.zeros((2, 16), np.float32))
    assert (info["reached"][0], info["held"][0], info["is_success"][0]) == (1.0, 0.0, False)


def test_a_computed_reward_has_the_bonus_only_where_the_object_is_held() -> None:
    env = HandEnv("Reorient", timestep=0.003)
    env.reset(seed=0)
    goal = np.array([1.0, 0.0, 0.0, 0.0])
    free, held = ({"held": value, "dropped": 0.0} for value in (0.0, 1.0))
    assert env.compute_reward(goal, goal, held) - env.compute_reward(goal, goal, free) == pytest.approx(10.0)
    assert env.compute_reward(np.stack([goal] * 2), np.stack([goal] * 2), [free, held]).tolist() == [
        env.compute_reward(goal, goal, each) for each in (free, held)
    ]
