"""Episodes of an environment become data sets that say what was seen, done and earned."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.collect import collect_episodes
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.policy.interface import Floats, Observation
from allegro_twin.recording.exchange.environment_episodes import EnvironmentEpisode, to_lerobot, to_minari

KEYWORDS: dict[str, Any] = {"timestep": 0.003, "decimation": 100}


class Wandering:
    """The same actions in every run of it."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(1)

    def __call__(self, observation: Observation) -> Floats:
        seen = observation["observation"] if isinstance(observation, dict) else observation
        return self.rng.uniform(-0.3, 0.3, (len(seen), 16)).astype(np.float32)


@pytest.fixture(scope="module")
def episodes() -> list[EnvironmentEpisode]:
    """Some of which succeed."""
    return collect_episodes(wavering, "Pinch", KEYWORDS | {"level": "easy"}, 4, seed=3)


def test_an_episode_is_the_single_environments_step_for_step() -> None:
    (episode,) = collect_episodes(Wandering(), "Reach", KEYWORDS, 1, seed=5)
    env, wandering = HandEnv("Reach", **KEYWORDS), Wandering()
    observation, _ = env.reset(seed=5)
    for k, action in enumerate(episode.action):
        assert isinstance(observation, dict)
        for name, values in observation.items():
            np.testing.assert_array_equal(episode.observation[name][k], values)
        np.testing.assert_array_equal(action, wandering({"observation": np.zeros((1, 1), np.float32)})[0])
        observation, reward, terminated, truncated, info = env.step(action)
        assert episode.reward[k] == reward
        assert episode.success[k] == info["is_success"]
    assert (terminated, truncated) == (episode.failed, True)


def wavering(observation: Observation) -> Floats:
    """What a row does follows from what that row sees."""
    assert not isinstance(observation, dict)
    action: Floats = (0.5 * np.sin(100.0 * observation[..., :16])).astype(np.float32)
    return action


def test_each_of_many_is_the_single_environments_of_its_seed() -> None:
    found = collect_episodes(wavering, "Pinch", KEYWORDS | {"level": "easy"}, 4, seed=3)
    assert any(episode.success.any() for episode in found)
    for number, episode in enumerate(found):
        env = HandEnv("Pinch", level="easy", **KEYWORDS)
        observation, _ = env.reset(seed=3 + number)
        for k in range(len(episode.action)):
            np.testing.assert_array_equal(episode.observation["observation"][k], observation)
            observation, reward, terminated, _, info = env.step(wavering(observation))
            assert (episode.reward[k], episode.success[k]) == (reward, info["is_success"])
        assert terminated == episode.failed


def test_episodes_end_where_they_ended(episodes: list[EnvironmentEpisode]) -> None:
    longest = max(len(episode.action) for episode in episodes)
    for episode in episodes:
        assert len(episode.observation["observation"]) == len(episode.action) + 1
        assert episode.failed or len(episode.action) == longest
        assert "(" in episode.task


def test_minari_s_set_has_rewards_ends_and_success(episodes: list[EnvironmentEpisode], tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="Minari's files are HDF5: extra demos")
    to_minari(episodes, tmp_path / "hand" / "grasp-v0", 0.3)
    folder = tmp_path / "hand" / "grasp-v0" / "data"
    assert json.loads((folder / "metadata.json").read_text())["dataset_id"] == "hand/grasp-v0"
    with h5py.File(folder / "main_data.hdf5") as file:
        for number, episode in enumerate(episodes):
            group = file[f"episode_{number}"]
            np.testing.assert_array_equal(group["observations"], episode.observation["observation"])
            np.testing.assert_array_equal(group["rewards"], episode.reward)
            assert (group["terminations"][-1], group["truncations"][-1]) == (episode.failed, not episode.failed)
            np.testing.assert_array_equal(group["infos/success"][1:], episode.success)


@pytest.mark.parametrize("task", ["Grasp", "Reach"])
def test_minari_itself_finds_a_set_by_its_id(task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = pytest.importorskip("minari", reason="only Minari itself can say whether it reads a data set")
    found = collect_episodes(Wandering(), task, KEYWORDS, 2, seed=0)
    to_minari(found, tmp_path / "hand" / "some-v0", 0.3)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    loaded = minari.load_dataset("hand/some-v0")
    for episode, read in zip(found, loaded.iterate_episodes(), strict=True):
        np.testing.assert_array_equal(read.rewards, episode.reward)
        np.testing.assert_array_equal(read.actions, episode.action)


def test_lerobot_s_set_has_rewards_and_success(episodes: list[EnvironmentEpisode], tmp_path: Path) -> None:
    to_lerobot(episodes, tmp_path / "set", 0.3, "allegro_right")
    table = pyarrow.parquet.read_table(tmp_path / "set" / "data" / "chunk-000" / "file-000.parquet")
    np.testing.assert_array_equal(table["next.success"], np.concatenate([each.success for each in episodes]))
    np.testing.assert_allclose(table["next.reward"], np.concatenate([each.reward for each in episodes]), rtol=1e-6)
    assert table["next.done"].to_pylist().count(True) == len(episodes)
    info = json.loads((tmp_path / "set" / "meta" / "info.json").read_text())
    assert (info["total_episodes"], info["robot_type"]) == (4, "allegro_right")
    assert info["features"]["observation.state"]["shape"] == [65]


def test_a_set_is_written_into_a_new_folder_that_minari_finds(
    episodes: list[EnvironmentEpisode], tmp_path: Path
) -> None:
    pytest.importorskip("h5py", reason="Minari's files are HDF5: extra demos")
    with pytest.raises(ConfigError, match="whose name ends in a version: grasp-v0"):
        to_minari(episodes, tmp_path / "grasp", 0.3)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    with pytest.raises(ConfigError, match="full is not empty"):
        to_lerobot(episodes, tmp_path / "full", 0.3, "allegro_right")
