"""`ArmPick`: Gymnasium's promises, what an action does, what is seen, and when a thing counts as picked."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence

import allegro_twin.gym
from allegro_twin.errors import CommandError, ConfigError
from allegro_twin.kinematics.arm import rotation_between
from allegro_twin.learning.tasks import task_type
from allegro_twin.learning.training.settings import load_recipe
from allegro_twin.pick.env import ArmPick
from allegro_twin.pick.scripted_policy import ScriptedPick
from allegro_twin.pick.settings import OBJECTS
from allegro_twin.surfaces.cli.learning.envs import environment_table

SCRIPTED = [{"control": "joints"}, {"control": "grasp", "perception": True}]


def apple(**more: Any) -> ArmPick:
    return ArmPick(objects=("apple",), **more)


def scripted(env: ArmPick, most: int = 1000) -> tuple[float, bool, dict[str, Any]]:
    """Return, whether it was terminated, and the last info."""
    script, earned = ScriptedPick(env), 0.0
    for _ in range(most):
        _, reward, lost, over, info = env.step(script())
        earned += reward
        if lost or over:
            break
    return earned, lost, info


@pytest.mark.slow
@pytest.mark.parametrize("control", ["joints", "grasp"])
def test_it_passes_the_checker_without_a_warning(control: str) -> None:
    check_env(gymnasium.make(allegro_twin.gym.PICK, render_mode="rgb_array", control=control).unwrapped)


@pytest.mark.slow
def test_it_passes_the_checker_of_stable_baselines3() -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(ArmPick())


@pytest.mark.slow
@pytest.mark.parametrize("kwargs", [{"camera_shift": 0.005, "camera_turn": 0.1}, {"perception": True}])
def test_the_same_seed_is_the_same_episode_whatever_was_before(kwargs: dict[str, Any]) -> None:
    first, second = ArmPick(objects=("apple", "mug"), **kwargs), ArmPick(objects=("apple", "mug"), **kwargs)
    second.reset(seed=8)
    second.step(second.action_space.sample())
    second.reset(seed=9)
    assert data_equivalence(first.reset(seed=3), second.reset(seed=3), exact=True)
    first.action_space.seed(0)
    for _ in range(10):
        action = first.action_space.sample()
        assert data_equivalence(first.step(action), second.step(action), exact=True)


@pytest.mark.slow
@pytest.mark.parametrize("kwargs", SCRIPTED)
def test_the_script_picks_an_apple_and_is_paid_for_it(kwargs: dict[str, Any]) -> None:
    env = apple(**kwargs)
    _, info = env.reset(seed=1)
    assert info["error"] < (0.003 if "perception" in kwargs else 1e-9)
    earned, lost, info = scripted(env)
    assert not lost
    assert info["is_success"]
    assert info["rise"] > 0.1
    assert earned > 50.0


def test_its_specification_says_how_long_an_episode_is() -> None:
    env = gymnasium.make("AllegroTwin/ArmPick-v0")
    assert env.spec is not None
    assert env.spec.max_episode_steps == env.unwrapped.episodes.limit  # type: ignore[attr-defined]


def test_an_episode_longer_than_its_own_warns_and_the_specification_is_true() -> None:
    env = gymnasium.make("AllegroTwin/ArmPick-v0", max_episode_steps=2000)  # Which the environment is not told.
    with pytest.warns(UserWarning, match="max_episode_steps is 2000, and an episode of AllegroTwin/ArmPick-v0 ends"):
        spec = env.spec
    assert spec is not None
    assert spec.max_episode_steps == env.unwrapped.episodes.limit  # type: ignore[attr-defined]


TWO = ("apple", "tennis_ball")
STATES: list[dict[str, Any]] = [
    {"camera_shift": 0.005, "camera_turn": 0.1, "camera_delay": 2},
    {"control": "grasp", "perception": True},
    {"hand": "leap"},
]


def played(env: ArmPick, steps: int) -> np.ndarray[Any, Any]:
    """All that random actions return, with the episodes that begin in between."""
    draws, found = np.random.default_rng(steps), []
    for _ in range(steps):
        observation, *rest, info = env.step(draws.uniform(-0.5, 0.5, env.action_space.shape).astype(np.float32))
        found.append(np.concatenate([observation, np.array([*rest, info["rise"], info["is_success"]])]))
        if rest[1] or rest[2]:
            observation, info = env.reset()
            found.append(np.concatenate([observation, [*info["at"], info["yaw"], info["error"]]]))
    return np.concatenate(found)


@pytest.mark.slow
@pytest.mark.parametrize("kwargs", STATES)
def test_an_episode_goes_on_from_a_saved_state_to_the_bit_and_so_do_those_after_it(kwargs: dict[str, Any]) -> None:
    env, fresh, other = (ArmPick(objects=TWO, seconds=1.6, **kwargs) for _ in range(3))
    for each, seed in ((other, 8), (env, 3)):
        each.reset(seed=seed)
        for _ in range(25):
            before = each.step(np.full(len(each.action_space.sample()), 0.1, np.float32))[0]
    state = env.save_state()
    first = played(env, 30)
    for again, saved in ((env, state), (fresh, pickle.loads(pickle.dumps(state))), (other, state)):
        np.testing.assert_array_equal(again.restore_state(saved), before)
        np.testing.assert_array_equal(played(again, 30), first)


def test_a_picture_of_a_restored_state_is_the_picture_of_then() -> None:
    env = apple(render_mode="rgb_array", width=64, height=48)
    env.reset(seed=3)
    for _ in range(10):
        env.step(np.full(22, 0.3, np.float32))
    state, picture = env.save_state(), env.render()
    played(env, 15)
    env.restore_state(state)
    np.testing.assert_array_equal(env.render(), picture)


def test_an_episode_that_is_over_is_over_when_it_is_restored() -> None:
    env, fresh = apple(seconds=0.2), apple(seconds=0.2)
    env.reset(seed=1)
    played(env, env.episodes.limit - 1)
    env.step(np.zeros(22, np.float32))
    fresh.restore_state(env.save_state())
    with pytest.raises(CommandError, match="no episode is going on"):
        fresh.step(np.zeros(22, np.float32))


@pytest.mark.slow
def test_a_grasp_is_held_on_from_a_saved_state() -> None:
    env = apple()
    env.reset(seed=1)
    script = ScriptedPick(env)
    info: dict[str, Any] = {"rise": 0.0}
    while info["rise"] < 0.105:  # So a part of the second has passed.
        *_, info = env.step(script())
    state, fresh = env.save_state(), apple()
    action = np.zeros(22, np.float32)
    action[2] = 0.4
    fresh.restore_state(state)
    for _ in range(60):
        assert data_equivalence(env.step(action), fresh.step(action), exact=True)
    assert fresh.episodes.moved()[0] > 0.15


def test_what_is_no_state_of_its_settings_is_refused_and_changes_nothing() -> None:
    env, other = apple(), apple(friction=0.5)
    with pytest.raises(CommandError, match="no episode has begun: reset before save_state"):
        env.save_state()
    for each in (env, other):
        each.reset(seed=1)
    state, before = env.save_state(), other.save_state().episode.scene.world.physics
    with pytest.raises(
        ConfigError, match=r"of environments with friction 0\.8, and these have 0\.5: make them with the"
    ):
        other.restore_state(state)
    with pytest.raises(ConfigError, match="restore_state takes what ArmPick's save_state has returned, not dict"):
        other.restore_state({})  # type: ignore[arg-type]
    np.testing.assert_array_equal(other.save_state().episode.scene.world.physics, before)


def test_many_side_by_side_are_saved_each_by_itself() -> None:
    envs = gymnasium.make_vec("AllegroTwin/ArmPick-v0", 2, objects=("apple",))
    envs.reset(seed=4)
    states = envs.call("save_state")  # type: ignore[attr-defined]
    action = np.full((2, 22), 0.2, np.float32)
    first = [envs.step(action)[0] for _ in range(4)]
    for each, state in zip(envs.envs, states, strict=True):  # type: ignore[attr-defined]
        each.unwrapped.restore_state(state)
    np.testing.assert_array_equal([envs.step(action)[0] for _ in range(4)], first)


def test_a_computer_that_renders_nothing_is_not_told_as_a_placement_out_of_reach(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: Any) -> None:
        raise ConfigError("nothing can be rendered here")

    monkeypatch.setattr("allegro_twin.pick.episode.DepthCamera", refuse)
    with pytest.raises(ConfigError, match="^nothing can be rendered here$"):
        apple(perception=True).reset(seed=0)


def test_nothing_earns_little_and_picks_nothing() -> None:
    env = apple()
    env.reset(seed=1)
    rewards = [env.step(np.zeros(22, np.float32))[1] for _ in range(40)]
    assert sum(rewards) < 0.1 * 40


@pytest.mark.slow
def test_what_is_lifted_is_picked_only_after_a_second() -> None:
    env = apple()
    env.reset(seed=1)
    script, high = ScriptedPick(env), 0
    while True:
        _, _, _, over, info = env.step(script())
        high = high + 1 if info["rise"] >= 0.1 else 0
        assert info["is_success"] == (high * env.episodes.seconds >= 1.0)
        if over:
            return


def test_what_is_up_for_a_second_in_all_but_not_at_a_stretch_is_not_picked() -> None:
    env = apple()
    env.reset(seed=1)
    joint, high = env.episodes.scene.robot.world.data.joint("apple"), 0
    for _ in range(12):
        for height in (0.35, None, None, 0.04):
            if height is not None:
                joint.qpos[:3], joint.qvel[:] = (-0.3, 0.3, height), 0.0
            *_, lost, _, info = env.step(np.zeros(22, np.float32))
            assert not lost or info["rise"] < 0.1
            env._over = False  # It was shoved too far, which does not matter here.
            high += info["rise"] >= 0.1
            assert not info["is_success"]
    assert high * env.episodes.seconds > 1.0


def test_an_action_displaces_the_palm_along_the_worlds_axes_and_turns_it() -> None:
    env = apple(off=0.0)
    env.reset(seed=1)
    before = env.episodes.scene.palm
    action = np.zeros(22, np.float32)
    action[2], action[5] = 1.0, 0.5
    env.step(action)
    for _ in range(40):
        env.step(np.zeros(22, np.float32))
    after = env.episodes.scene.palm
    np.testing.assert_allclose(after.position - before.position, [0.0, 0.0, 0.02], atol=0.003)
    np.testing.assert_allclose(rotation_between(before.rotation, after.rotation), [0.0, 0.0, 0.05], atol=0.02)


def test_a_set_point_does_not_run_away_from_a_palm_that_does_not_follow() -> None:
    env = apple()
    env.reset(seed=1)
    down = np.zeros(22, np.float32)
    down[2] = -1.0
    for _ in range(60):
        if env.step(down)[2]:
            break
        ahead = env.episodes.scene.aim.position - env.episodes.scene.palm.position
        assert np.linalg.norm(ahead) < 0.06 + 0.02


def test_a_thing_that_falls_off_the_table_ends_the_episode() -> None:
    env = apple()
    env.reset(seed=1)
    scene = env.episodes.scene
    scene.robot.world.data.joint("apple").qpos[:3] = [1.0, 1.0, -0.5]
    *_, lost, _, info = env.step(np.zeros(22, np.float32))
    assert lost
    assert not info["is_success"]
    with pytest.raises(CommandError, match="no episode is going on.*reset before the next step"):
        env.step(np.zeros(22, np.float32))


def test_with_perception_the_thing_is_where_the_picture_showed_it_and_else_where_it_is() -> None:
    for perception in (True, False):
        env = apple(perception=perception)
        env.reset(seed=1)
        seen = env.episodes.track.pose.position
        env.episodes.scene.robot.world.data.joint("apple").qpos[:2] += 0.05
        env.step(np.zeros(22, np.float32))
        moved = np.linalg.norm(env.episodes.track.pose.position - seen)
        assert moved == 0.0 if perception else moved > 0.06


def test_a_camera_that_is_late_shows_where_the_thing_was() -> None:
    env = apple(camera_delay=2)
    env.reset(seed=1)
    seen = env.episodes.track.pose.position
    env.episodes.scene.robot.world.data.joint("apple").qpos[2] += 0.1
    moved = []
    for _ in range(3):
        env.step(np.zeros(22, np.float32))
        moved.append(float(np.linalg.norm(env.episodes.track.pose.position - seen)))
    assert moved[1] == pytest.approx(0.0, abs=1e-9)
    assert moved[2] > 0.01


def inside(env: ArmPick) -> float:
    """How deep hand or arm is in the table, in the object, or in the other, m, by a simulation of its own."""
    world = env.episodes.scene.robot.world
    data = mujoco.MjData(world.model)
    data.qpos[:] = world.data.qpos
    mujoco.mj_forward(world.model, data)
    standing = {"world", env.episodes.scene.name}
    bodies = [{world.model.body(world.model.geom_bodyid[geom]).name for geom in each.geom} for each in data.contact]
    return max((-float(each.dist) for each, pair in zip(data.contact, bodies, strict=True) if pair != standing),
               default=0.0)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("off", [0.03, 0.05])
def test_no_episode_begins_with_hand_or_arm_in_the_table_or_the_object(side: str, off: float) -> None:
    env = ArmPick(side=side, off=off)
    for seed in range(20):
        env.reset(seed=seed)
        assert inside(env) == 0.0, seed


@pytest.mark.slow
def test_of_the_usual_objects_a_hand_has_those_that_it_takes() -> None:
    left: dict[str, Any] = {"side": "left"}
    leap: dict[str, Any] = {"hand": "leap"}
    for kwargs, missing in ((left, {"mug", "tomato_soup_can", "sugar_box"}), (leap, {"sugar_box"})):
        env = ArmPick(**kwargs)
        seen = {env.reset(seed=seed)[1]["object"] for seed in range(40)}
        assert seen == set(OBJECTS) - missing


@pytest.mark.slow
def test_an_object_that_the_hand_does_not_take_is_refused_where_it_is_named() -> None:
    message = "ArmPick has no mug for allegro_.*left.*: at its mug grasp fer_link7 would be 22.0 mm inside the table"
    with pytest.raises(ConfigError, match=message):
        ArmPick(side="left", objects=("apple", "mug"))
    env = ArmPick(side="left")
    with pytest.raises(ConfigError, match=message):
        env.reset(seed=0, options={"object": "mug"})


def test_an_episode_takes_what_it_is_told() -> None:
    env = ArmPick(objects=("apple", "mug"))
    for name in ("mug", "apple"):
        _, info = env.reset(seed=0, options={"object": name, "at": (0.02, -0.03), "yaw": 30.0})
        assert (info["object"], info["at"], round(info["yaw"], 6)) == (name, [0.02, -0.03], 30.0)
        np.testing.assert_allclose(env.episodes.scene.there.position[:2], [0.02, -0.03], atol=1e-6)


@pytest.mark.parametrize(("kwargs", "message"), [
    ({"objects": ("aple",)}, "no object named 'aple'; did you mean 'apple'"), ({"controll": "grasp"}, "controll"),
    ({"render_mode": "human"}, "ArmPick has rgb_array"),
])  # fmt: skip
def test_what_cannot_be_is_refused_in_one_line(kwargs: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        ArmPick(**kwargs)


@pytest.mark.slow
def test_after_a_reset_that_found_no_beginning_a_step_wants_another_reset() -> None:
    env = apple()
    for name in ("apple", "lemon"):  # In the scene of the episode before, and in one of its own.
        env.reset(seed=0)
        with pytest.raises(ConfigError, match=f"no placement of {name} that the arm reaches"):
            env.reset(options={"object": name, "at": (1.0, 1.0)})
        with pytest.raises(CommandError, match="no episode is going on.*reset before the next step"):
            env.step(np.zeros(22, np.float32))


@pytest.mark.parametrize("options", [{"object": "aple"}, {"objekt": "apple"}, {"object": "mug"}, {"yaw": "left"}])
def test_an_episode_goes_on_after_a_reset_whose_options_were_refused(options: dict[str, Any]) -> None:
    env, other = apple(side="left"), apple(side="left")
    for each in (env, other):
        each.reset(seed=0)
    with pytest.raises(ConfigError):
        env.reset(seed=1, options=options)
    action = np.full(22, 0.1, np.float32)
    assert data_equivalence(env.step(action), other.step(action), exact=True)
    assert data_equivalence(env.reset(), other.reset(), exact=True)


@pytest.mark.parametrize("name", ["camera_shift", "camera_turn", "camera_delay"])
def test_what_blurs_a_camera_that_looks_at_every_decision_is_refused_beside_perception(name: str) -> None:
    with pytest.raises(ConfigError, match=f"perception=True looks once, so {name} does nothing"):
        apple(perception=True, **{name: 1})


def test_an_action_that_is_none_is_refused() -> None:
    env = apple()
    env.reset(seed=0)
    with pytest.raises(CommandError, match="shape"):
        env.step(np.zeros(16, np.float32))
    with pytest.raises(CommandError, match="not finite"):
        env.step(np.full(22, np.nan, np.float32))


def test_what_needs_a_batch_says_that_there_is_none() -> None:
    for refused in (load_recipe, task_type):
        with pytest.raises(ConfigError, match="ArmPick is a single environment"):
            refused("ArmPick")
    assert environment_table("ArmPick").row_count == 1


def test_it_goes_through_a_pickle_as_it_was_made() -> None:
    env = apple(control="grasp")
    copy = pickle.loads(pickle.dumps(env))
    assert copy.settings == env.settings
    assert data_equivalence(env.reset(seed=1), copy.reset(seed=1), exact=True)
