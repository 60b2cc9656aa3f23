"""Pictures and depths are part of observations on request: the same alone and in a batch, and without any effect."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import allegro_twin.gym  # noqa: F401  # It registers the ids.
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.learning.environments.collect import collect_episodes
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.policy.controller import ZeroPolicy
from allegro_twin.learning.training.settings import Recipe

SMALL: dict[str, Any] = {"observe": ("rgb", "depth"), "resolution": "24x16", "timestep": 0.003}
ACTIONS = np.random.default_rng(0).uniform(-1.0, 1.0, (4, 16)).astype(np.float32)


def test_an_observation_has_pictures_of_the_scene_and_depths_in_metres() -> None:
    env = HandEnv("Rotate", decimation=20, objects=("cube",), **SMALL)
    seen: Any = env.reset(seed=0)[0]
    assert {*seen} == {"observation", "rgb", "depth"}
    assert (seen["rgb"].shape, seen["rgb"].dtype) == ((16, 24, 3), np.uint8)
    assert (seen["depth"].shape, seen["depth"].dtype) == ((16, 24), np.float32)
    assert env.observation_space.contains(seen)
    assert seen["rgb"].std() > 10.0
    assert 0.3 < seen["depth"].min() < 0.42, "the camera is 0.42 m from the middle of the grasp"
    thing: Any = env.engine.task.object_body
    thing.pose[0, 2] += 1.0  # Out of sight.
    gone: Any = env.engine.fetch(env.engine.observe())
    assert gone["depth"][0].mean() > seen["depth"].mean()
    assert np.abs(gone["rgb"][0].astype(int) - seen["rgb"]).max() > 50
    env.close()


def test_several_cameras_have_their_names() -> None:
    env = HandEnv("Reach", cameras=("front", "0,-30,0.5"), **SMALL | {"observe": ("rgb",)})
    seen: Any = env.reset(seed=0)[0]
    assert {*seen} >= {"rgb_front", "rgb_0,-30,0.5"}
    assert not np.array_equal(seen["rgb_front"], seen["rgb_0,-30,0.5"])
    assert env.observation_space.contains(seen)


@pytest.mark.parametrize(("task", "objects"), [("Rotate", ("cube", "ball")), ("Lift", ("lemon", "foam_brick"))])
def test_pictures_of_a_batch_are_those_of_each_alone_to_the_bit(task: str, objects: tuple[str, ...]) -> None:
    given = {"randomise": "default", "objects": objects, **SMALL}
    envs = HandVectorEnv(task, 3, autoreset_mode="disabled", **given)
    batch: list[Any] = [envs.reset(seed=5)[0], *(envs.step(np.stack([each] * 3))[0] for each in ACTIONS[:2])]
    env = HandEnv(task, **given)
    for row in (0, 2):
        alone: list[Any] = [env.reset(seed=5 + row)[0], *(env.step(each)[0] for each in ACTIONS[:2])]
        for one, many in zip(alone, batch, strict=True):
            for name in ("observation", "rgb", "depth"):
                np.testing.assert_array_equal(one[name], many[name][row], err_msg=name)
    assert not np.array_equal(batch[0]["rgb"][0], batch[0]["rgb"][1])
    assert envs.observation_space.contains(batch[0])


def test_pictures_change_nothing_else_and_come_again_from_a_saved_state() -> None:
    plain, with_them = HandEnv("Reorient", timestep=0.003), HandEnv("Reorient", **SMALL)
    plain.reset(seed=1)
    with_them.reset(seed=1)
    ours: Any
    theirs: Any
    for action in ACTIONS:
        state = with_them.save_state()
        ours, theirs = plain.step(action), with_them.step(action)
        assert ours[1:] == theirs[1:]
        for name, part in ours[0].items():
            np.testing.assert_array_equal(part, theirs[0][name])
    with_them.restore_state(state)
    again: Any = with_them.step(ACTIONS[-1])[0]
    np.testing.assert_array_equal(again["rgb"], theirs[0]["rgb"])
    np.testing.assert_array_equal(again["depth"], theirs[0]["depth"])


@pytest.mark.filterwarnings("error")
@pytest.mark.filterwarnings("ignore:.*a Dict:UserWarning")
def test_gymnasiums_own_checks_pass() -> None:
    check_env(HandEnv("Reach", **SMALL), skip_render_check=True)
    envs = gymnasium.make_vec("AllegroTwin/Reach-v0", 2, **SMALL)
    envs.reset(seed=0)
    assert envs.observation_space.contains(envs.step(np.zeros((2, 16), np.float32))[0])
    envs.close()


def test_a_simulation_that_has_diverged_shows_zeros() -> None:
    envs = HandVectorEnv("Reach", 2, **SMALL)
    envs.reset(seed=0)
    envs.engine.worlds.position[1] = np.nan
    assert envs.engine.pictures is not None
    seen = envs.engine.pictures.take()
    assert (seen["rgb"][0].max(), seen["rgb"][1].max(), seen["depth"][1].max()) == (seen["rgb"][0].max(), 0, 0.0)
    assert seen["rgb"][0].max() > 0


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"observe": ("rgb",), "device": "warp"}, "rendered of simulations on processors: device cpu, not warp"),
        ({"observe": ("rbg",)}, "observe"),
        ({"observe": ("rgb", "rgb")}, "observe has one of rgb, rgb twice"),
        ({"observe": ("rgb",), "resolution": "84"}, "resolution"),
        ({"observe": ("rgb",), "resolution": "9999x9999"}, "resolution: width and height are up to 8192 pixels each"),
        ({"observe": ("rgb",), "cameras": ("sdie",)}, "sdie"),
        ({"cameras": ("top",)}, "cameras is of pictures in observations: give observe, too"),
        ({"resolution": "64x64"}, "resolution is of pictures in observations: give observe, too"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        HandEnv("Reach", **keywords)
    assert "\n" not in str(error.value)


def test_learners_and_data_sets_that_have_no_pictures_say_so() -> None:
    with pytest.raises(ValueError, match="environment.observe: no learner here has a network for pictures"):
        Recipe.model_validate({"task": "Reach", "environment": {"observe": ["rgb"]}})
    with pytest.raises(ConfigError, match="data sets of episodes have no pictures"):
        collect_episodes(ZeroPolicy(16), "Reach", {"observe": ("rgb",)}, 1)
    card = HandEnv("Reach", **SMALL).engine.task.card()
    with pytest.raises(ConfigError, match="sees pictures \\(rgb, depth\\), which no hand reports"):
        card.interface(load_spec())


@pytest.mark.slow
def test_stable_baselines3_learns_from_pictures_with_its_own_policy() -> None:
    sb3 = pytest.importorskip("stable_baselines3", reason="it trains: extra rl")
    env = gymnasium.make("AllegroTwin/Rotate-v0", observe=("rgb", "depth"), observation="hand", resolution="40x40")
    model = sb3.PPO("MultiInputPolicy", env, n_steps=8, batch_size=4, n_epochs=1, device="cpu").learn(8)
    action, _ = model.predict(env.reset(seed=0)[0])
    assert env.action_space.contains(action)
