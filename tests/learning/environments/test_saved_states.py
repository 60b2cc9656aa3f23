"""An episode can be saved, and goes on from there to the bit: in the same environment, in another, in a batch."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import allegro_twin.gym  # noqa: F401  # Registers the ids.
from allegro_twin.errors import CommandError, ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.episode import EpisodeBackend
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.types import PositionCommand
from tests.learning.environments.test_posterior import table, write

RANDOM: dict[str, Any] = {"timestep": 0.003, "randomise": "default"}
N = 3


def flat(observation: Any) -> np.ndarray[Any, Any]:
    parts = observation.values() if isinstance(observation, dict) else (observation,)
    return np.concatenate([np.asarray(part, np.float64).reshape(-1) for part in parts])


def played(env: Any, seed: int, steps: int) -> list[np.ndarray[Any, Any]]:
    rng, found = np.random.default_rng(seed), []
    shape = env.action_space.shape
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(rng.uniform(-0.5, 0.5, shape).astype(np.float32))
        found.append(np.concatenate([flat(observation), np.ravel(reward), np.ravel(terminated), np.ravel(truncated)]))
        found[-1] = np.append(found[-1], np.ravel(info["is_success"]))
        if np.ndim(terminated) == 0 and (terminated or truncated):
            found.append(flat(env.reset()[0]))  # The next episode is drawn from the same numbers.
    return found


@pytest.mark.parametrize("task", ["Reach", "Grasp", "Lift", "HoldDisturbed", "Rotate", "Reorient"])
def test_an_episode_goes_on_from_a_saved_state_to_the_bit(task: str) -> None:
    env, other = (HandEnv(task, **RANDOM) for _ in range(2))
    env.reset(seed=4)
    played(env, 0, 4)
    state = env.save_state()
    first = played(env, 1, 12)
    before = env.restore_state(state)
    again = played(env, 1, 12)
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(again))
    other.reset(seed=99)
    seen = other.restore_state(pickle.loads(pickle.dumps(state)))
    np.testing.assert_array_equal(flat(seen), flat(before))
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(played(other, 1, 12)))


def test_the_observation_of_a_restored_state_is_the_one_before_it_was_saved() -> None:
    env = HandEnv("Rotate", **RANDOM, history=3)
    env.reset(seed=4)
    action = np.full(16, 0.2, np.float32)
    seen = [env.step(action)[0] for _ in range(4)][-1]
    state = env.save_state()
    played(env, 1, 5)
    np.testing.assert_array_equal(flat(env.restore_state(state)), flat(seen))


@pytest.mark.parametrize("hand", ["allegro", "leap"])
def test_a_restored_observation_has_the_forces_of_its_last_step(hand: str) -> None:
    given: dict[str, Any] = {"hand": hand, "timestep": 0.003, "touch": True, "state": True}
    env, new = (HandEnv("Rotate", **given) for _ in range(2))
    env.reset(seed=4)
    seen = [env.step(np.full(16, 0.2, np.float32))[0] for _ in range(4)][-1]
    state = env.save_state()
    played(env, 1, 5)
    np.testing.assert_array_equal(flat(env.restore_state(state)), flat(seen))
    np.testing.assert_array_equal(flat(new.restore_state(state)), flat(seen))


OF_HANDS = [
    *(("allegro", task) for task in ("Reach", "Grasp", "Lift", "Pinch", "HoldDisturbed", "Reorient", "Rotate")),
    *(("leap", task) for task in ("Reach", "Lift", "Reorient", "Rotate")),
    *((hand, "Lift") for hand in ("model_o", "sih", "qb_softhand")),
]


@pytest.mark.parametrize(("hand", "task"), OF_HANDS)
def test_the_first_episode_of_an_environment_is_its_second_with_the_same_seed(hand: str, task: str) -> None:
    step = load_spec(hand).longest_step(0.003)
    env = HandEnv(task, hand=hand, timestep=step)  # Nothing that it observes reads forces before the first step.
    first, second = ([flat(env.reset(seed=5)[0]), *played(env, 2, 3)] for _ in range(2))
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(second))


def test_the_first_state_of_an_episode_has_no_torque_of_the_episode_before() -> None:
    episode = EpisodeBackend("Rotate", EnvSettings(hand="leap", timestep=0.003), seed=5)
    first = episode.reset()
    for _ in range(3):
        episode.write(PositionCommand(first.position))
        episode.read()
    np.testing.assert_array_equal(episode.reset().torque, first.torque)


@pytest.mark.parametrize("before", [4, 6])
def test_a_batch_goes_on_through_its_resets(before: int) -> None:
    env = HandVectorEnv("Rotate", N, max_episode_steps=6, **RANDOM)
    env.reset(seed=4)
    played(env, 0, before)
    state = env.save_state()
    first = played(env, 1, 12)  # Two resets of everyone.
    env.restore_state(state)
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(played(env, 1, 12)))
    fresh = HandVectorEnv("Rotate", N, max_episode_steps=6, **RANDOM)
    fresh.reset(seed=1)
    fresh.restore_state(state)
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(played(fresh, 1, 12)))


EVERYTHING: dict[str, Any] = RANDOM | {"touch": True, "state": True, "history": 2}
OF_SETTINGS: list[tuple[str, dict[str, Any]]] = [
    *((task, given) for task in ("Reach", "Grasp", "Lift", "Pinch", "HoldDisturbed") for given in ({}, EVERYTHING)),
    *((task, EVERYTHING) for task in ("Rotate", "Reorient")),
    ("Rotate", RANDOM | {"observation": "full", "control": "torque"}),
    ("Rotate", {"palm": "allowed", "control": "absolute"}),
    ("Reorient", EVERYTHING | {"hand": "leap"}),
    ("Lift", EVERYTHING | {"hand": "sih"}),
    ("Grasp", RANDOM | {"observe": ("rgb", "depth"), "resolution": "24x16"}),
    ("Rotate", EVERYTHING | {"observe": ("rgb",), "resolution": "24x16"}),
    ("Reach", {"randomise": {"twin": "a hand"}, "touch": True, "state": True}),
]


@pytest.fixture(params=OF_SETTINGS, ids=lambda case: "-".join([case[0], *map(str, case[1])]))
def pair(request: pytest.FixtureRequest) -> Any:
    """Makes an environment and another one, with a past of its own, single (None) or of so many."""
    task, given = request.param
    keywords = {"timestep": 0.003} | given
    if keywords.get("randomise") == {"twin": "a hand"}:
        keywords |= {"randomise": {"twin": write(table(bias_torque=[0.01] * 16))}}

    def make(n: int | None) -> tuple[Any, Any]:
        env, other = (HandEnv(task, **keywords) if n is None else HandVectorEnv(task, n, **keywords) for _ in range(2))
        for each, seed in ((env, 4), (other, 9)):
            each.reset(seed=seed)
            played(each, seed, 14 if each is env else 3)
        return env, other

    return make


@pytest.mark.parametrize("n", [None, 2])
def test_in_an_environment_with_a_past_an_episode_goes_on_to_the_bit_with_any_settings(
    pair: Any, n: int | None
) -> None:
    env, other = pair(n)
    state = pickle.loads(pickle.dumps(env.save_state()))
    first = np.concatenate(played(env, 1, 6))
    other.restore_state(state)
    np.testing.assert_array_equal(first, np.concatenate(played(other, 1, 6)))
    env.restore_state(state)
    np.testing.assert_array_equal(first, np.concatenate(played(env, 1, 6)))


# A step begins by planning the first four anew; palettes follow from the models; a reset draws and reports the last.
PASSING = ("/task/_path", "/task/_forces", "/task/_holding", "/task/_course", "/worlds/_palettes", "/engine/_drawn")


def attributes(value: Any, path: str, found: dict[str, Any], seen: set[int]) -> dict[str, Any]:
    """Arrays, numbers and strings of everything that belongs to an environment, by their paths."""
    if isinstance(value, np.ndarray | np.generic | bool | int | float | str | None):
        found[path] = np.array(value)
    if id(value) in seen:
        return found
    seen.add(id(value))
    parts: Any = ()
    if isinstance(value, dict):
        parts = value.items()
    elif hasattr(value, "_asdict"):
        parts = value._asdict().items()
    elif isinstance(value, list | tuple):
        parts = enumerate(value)
    elif type(value).__module__.startswith(("allegro_twin.learning.", "allegro_twin.sim.batch.")):
        parts = vars(value).items() if hasattr(value, "__dict__") and not hasattr(type(value), "model_fields") else ()
    for name, part in parts:
        if not f"{path}/{name}".endswith(PASSING):
            attributes(part, f"{path}/{name}", found, seen)
    return found


@pytest.mark.parametrize("n", [None, 2])
def test_whatever_an_episode_changes_is_told(pair: Any, n: int | None) -> None:
    """A new attribute that changes and that no `live_arrays` names is found here, by its path."""
    env, other = pair(n)
    other.restore_state(env.save_state())
    ours, theirs = (attributes(each, "env", {}, set()) for each in (env, other))
    assert len(ours) > 80
    assert ours.keys() == theirs.keys()
    for name, value in ours.items():
        np.testing.assert_array_equal(value, theirs[name], err_msg=name)


def test_a_saved_state_does_not_change_while_its_episode_goes_on() -> None:
    env = HandEnv("Grasp", timestep=0.003)
    env.reset(seed=4)
    state = env.save_state()
    kept = pickle.dumps(state)
    played(env, 1, 5)
    assert pickle.dumps(state) == kept


@pytest.mark.parametrize("task", ["Reach", "Rotate"])
def test_what_a_step_has_given_out_stays_as_it_was_when_a_state_is_restored(task: str) -> None:
    single, batch = HandEnv(task, timestep=0.003), HandVectorEnv(task, N, timestep=0.003)
    for env in (single, batch):
        env.reset(seed=4)
        state = env.save_state()
        out = env.step(np.full(env.action_space.shape or (), 0.3, np.float32))
        kept = pickle.dumps(out)
        env.restore_state(state)
        assert pickle.dumps(out) == kept


@pytest.mark.parametrize(
    ("task", "its", "others", "words"),
    [
        ("Grasp", {}, {"randomise": "default"}, r"randomise\.mass \[0\.7, 1\.3\], and these have None"),
        ("Grasp", {}, {"level": "easy"}, "level easy, and these have default"),
        ("Grasp", {}, {"side": "left"}, "side left, and these have right"),
        ("Grasp", {"objects": ("apple",)}, {"objects": ("mug",)}, r"objects \['mug'\], and these have \['apple'\]"),
        ("Grasp", {}, {"reward": {"hold": 3.0}}, r"reward\.hold 3\.0, and these have None"),
        ("Rotate", {}, {"grip": "cradle"}, "grip cradle, and these have pinch"),
        ("Reorient", {}, {"goals": "yaw"}, "goals yaw, and these have any"),
        ("Reach", {}, {"step": 0.2}, r"step 0\.2, and these have"),
        ("Reach", {}, {"decimation": 10}, "decimation 10, and these have 13"),
    ],
)
def test_a_state_of_other_keywords_is_refused_and_changes_nothing(
    task: str, its: dict[str, Any], others: dict[str, Any], words: str
) -> None:
    env, untouched = (HandEnv(task, timestep=0.003, **its) for _ in range(2))
    other = HandEnv(task, timestep=0.003, **others)
    for each in (env, untouched, other):
        each.reset(seed=0)
    with pytest.raises(ConfigError, match=words):
        env.restore_state(other.save_state())
    np.testing.assert_array_equal(np.concatenate(played(env, 1, 3)), np.concatenate(played(untouched, 1, 3)))
    np.testing.assert_array_equal(flat(env.reset()[0]), flat(untouched.reset()[0]))


def test_a_state_of_another_task_or_number_or_way_to_go_on_is_refused() -> None:
    single, other = HandEnv("Grasp", timestep=0.003), HandEnv("Pinch", timestep=0.003)
    pair, same = (HandVectorEnv("Grasp", 2, timestep=0.003, autoreset_mode=mode) for mode in ("next_step", "same_step"))
    for each in (single, other, pair, same):
        each.reset(seed=0)
    for env, state, words in [
        (single, other.save_state(), "task Pinch, and these have Grasp"),
        (single, pair.save_state(), "num_envs 2, and these have 1"),
        (same, pair.save_state(), "autoreset_mode next_step, and these have same_step"),
        (single, None, "restore_state takes what save_state has returned, not NoneType"),
    ]:
        with pytest.raises(ConfigError, match=words):
            env.restore_state(state)  # type: ignore[attr-defined]


@pytest.mark.parametrize(("task", "more"), [("Reorient", {}), ("Rotate", {"history": 3}), ("Grasp", {})])
def test_a_new_environment_goes_on_from_a_state_without_a_reset(task: str, more: dict[str, Any]) -> None:
    env = HandEnv(task, **RANDOM, **more)
    env.reset(seed=4)
    played(env, 0, 3)
    state = env.save_state()
    first = played(env, 1, 6)
    new = HandEnv(task, **RANDOM, **more, render_mode="rgb_array", width=64, height=64)
    new.restore_state(state)
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(played(new, 1, 6)))
    pair = HandVectorEnv(task, 2, **RANDOM, **more)
    pair.reset(seed=4)
    kept = pair.save_state()
    again = played(pair, 1, 4)
    fresh = HandVectorEnv(task, 2, **RANDOM, **more)
    fresh.restore_state(kept)
    np.testing.assert_array_equal(np.concatenate(again), np.concatenate(played(fresh, 1, 4)))


def test_a_made_environment_goes_on_without_a_reset_and_one_without_either_is_refused() -> None:
    env, new = (gymnasium.make("AllegroTwin/Reach-v0", timestep=0.003, disable_env_checker=True) for _ in range(2))
    action = np.zeros(16, np.float32)
    with pytest.raises(CommandError, match="a step before the first reset"):
        new.step(action)
    env.reset(seed=4)
    new.unwrapped.restore_state(env.unwrapped.save_state())  # type: ignore[attr-defined]
    np.testing.assert_array_equal(flat(env.step(action)[0]), flat(new.step(action)[0]))


def test_a_state_brings_the_objects_that_resets_have_named() -> None:
    env, new, other = (HandEnv("Grasp", timestep=0.003, objects=("apple",)) for _ in range(3))
    env.reset(seed=4, options={"object": "softball"})
    played(env, 0, 2)
    state = env.save_state()
    first = played(env, 1, 5)
    new.restore_state(pickle.loads(pickle.dumps(state)))
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(played(new, 1, 5)))
    other.reset(seed=4, options={"object": "orange"})
    with pytest.raises(ConfigError, match="object 'softball' where this environment's had object 'orange'"):
        other.restore_state(state)


def test_the_step_of_a_reset_reports_nothing_of_the_episode_before() -> None:
    pair, single = HandVectorEnv("Rotate", 2, timestep=0.003), HandEnv("Rotate", timestep=0.003)
    pair.reset(seed=[3, 4])
    wild, still = (
        np.sign(np.random.default_rng(1).normal(size=(2, 16))).astype(np.float32),
        np.zeros((2, 16), np.float32),
    )
    lost = np.zeros(2, bool)
    while not lost[0]:
        _, _, lost, _, info = pair.step(wild)
    assert info["dropped"][0] < 0.0, "palm or proximal links touch the object"
    assert info["by_palm"][0] + info["by_middle"][0] > 0.0
    single.reset(seed=3)
    single.reset()
    *_, info = pair.step(still)
    first, *_, alone = single.step(still[0])
    assert all(info[name][0] == 0.0 for name in alone), "it begins anew"
    seen, *_, info = pair.step(still)
    assert {name: info[name][0] for name in alone} == alone
    assert isinstance(seen, np.ndarray)
    np.testing.assert_array_equal(seen[0], first)


def test_what_an_option_changed_since_is_as_it_was() -> None:
    env = HandEnv("Lift", timestep=0.003, level="easy")
    env.reset(seed=4)
    state = env.save_state()
    first = played(env, 1, 6)
    env.reset(seed=5, options={"friction": 0.3, "size": 1.05})
    played(env, 2, 3)
    friction = env.engine.worlds.expand("geom_friction")
    assert friction[0, :, 0].max() == 0.3
    env.restore_state(state)
    np.testing.assert_array_equal(friction[0], env.engine.worlds.model.geom_friction)
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(played(env, 1, 6)))


def test_an_episode_longer_than_the_task_s_is_refused_or_warned_of_and_the_specification_is_true() -> None:
    with pytest.raises(ConfigError, match="max_episode_steps is 300, and an episode of this task ends after 51 action"):
        gymnasium.make_vec("AllegroTwin/Reach-v0", 2, max_episode_steps=300)
    env = gymnasium.make("AllegroTwin/Reach-v0", max_episode_steps=300)  # Which the environment is not told.
    with pytest.warns(UserWarning, match="max_episode_steps is 300, and an episode of AllegroTwin/Reach-v0 ends after"):
        spec = env.spec
    assert spec is not None
    assert spec.max_episode_steps == 51
    again = gymnasium.make(spec)
    assert again.spec is not None
    assert again.spec.max_episode_steps == 51
    assert pickle.loads(pickle.dumps(spec)).max_episode_steps == 51


def test_the_length_of_an_episode_is_in_gymnasiums_specification() -> None:
    for decimation, steps in ((13, 51), (26, 26)):
        env = gymnasium.make("AllegroTwin/Reach-v0", decimation=decimation)
        assert env.spec is not None
        assert env.spec.max_episode_steps == steps
        env.reset(seed=0)
        taken = 0
        truncated = False
        while not truncated:
            _, _, _, truncated, _ = env.step(np.zeros(16, np.float32))
            taken += 1
        assert taken == steps
    short = gymnasium.make("AllegroTwin/Reach-v0", max_episode_steps=5)
    assert short.spec is not None
    assert short.spec.max_episode_steps == 5
    free = gymnasium.make("AllegroTwin/Reach-v0", max_episode_steps=-1)
    assert free.spec is not None
    assert free.spec.max_episode_steps == 51, "the task's own"
    envs = gymnasium.make_vec("AllegroTwin/Reach-v0", 2, autoreset_mode=AutoresetMode.SAME_STEP)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert envs.spec is not None
    assert envs.spec.max_episode_steps == 51
