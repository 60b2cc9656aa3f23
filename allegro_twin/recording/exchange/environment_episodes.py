"""Episodes of a Gymnasium environment as data sets of Minari and LeRobot."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.files.atomic_write import atomic_folder
from allegro_twin.recording.exchange import minari
from allegro_twin.recording.exchange.episodes import check_new_folder
from allegro_twin.recording.exchange.lerobot import DatasetOrigin, LerobotEpisode, write_dataset
from allegro_twin.recording.exchange.minari import box_space, dataset_id, import_h5py

OBSERVATION = "observation"


@dataclass(frozen=True, slots=True, eq=False)
class EnvironmentEpisode:
    """One episode of k steps."""

    environment: str
    """Id of the environment."""
    task: str
    """Text of the task."""
    observation: Mapping[str, NDArray[np.float32]]
    """By part, (k + 1, …): before each step, and after the last. An observation without parts has the key
    `observation`."""
    action: NDArray[np.float32]
    """(k, n)."""
    reward: NDArray[np.float64]
    """(k,)."""
    success: NDArray[np.bool_]
    """After each step, (k,)."""
    failed: bool
    """The environment terminated the episode; otherwise its time was over."""


def to_minari(episodes: Sequence[EnvironmentEpisode], folder: Path, period: float) -> None:
    """Write a new Minari data set, whole or not at all; its id is `dataset_id(folder)`. `period`: of a step, s. Raises
    ConfigError without h5py, and for a folder that is not empty or has another name."""
    import_h5py()
    dataset_id(folder)
    check_new_folder(folder)
    first = episodes[0]
    content = {
        "description": f"{first.environment}: {first.task}; {period:g} s a step",
        "observation_space": _space(first.observation),
        "action_space": json.dumps(box_space(first.action)),
    }
    steps = [len(episode.action) for episode in episodes]
    minari.write_dataset(folder, steps, lambda group, number: _add(group, episodes[number]), content)


def to_lerobot(episodes: Sequence[EnvironmentEpisode], folder: Path, period: float, robot: str) -> None:
    """Write a new LeRobot data set, whole or not at all. Its frames are the steps: the observation before the step, and
    its result (`next.…`). Raises ConfigError for a folder that is not empty."""
    check_new_folder(folder)
    with atomic_folder(folder) as temporary:
        write_dataset(
            [LerobotEpisode(each.task, _features(each)) for each in episodes],
            DatasetOrigin(robot, period, {}),
            temporary,
        )


def _features(episode: EnvironmentEpisode) -> dict[str, NDArray[Any]]:
    names = {
        name: "observation.state" if name == OBSERVATION else f"observation.{name}" for name in episode.observation
    }
    last = np.zeros(len(episode.action), bool)
    last[-1:] = True
    return {names[name]: values[:-1] for name, values in episode.observation.items()} | {
        "action": episode.action,
        "next.reward": episode.reward.astype(np.float32),
        "next.done": last,
        "next.success": episode.success,
    }


def _add(group: Any, episode: EnvironmentEpisode) -> None:
    steps = len(episode.action)
    last = np.zeros(steps, bool)
    last[-1:] = True
    if set(episode.observation) == {OBSERVATION}:
        group["observations"] = episode.observation[OBSERVATION]
    else:
        parts = group.create_group("observations")
        for name, values in episode.observation.items():
            parts[name] = values
    group["actions"], group["rewards"] = episode.action, episode.reward
    group["terminations"], group["truncations"] = last & episode.failed, last & (not episode.failed)
    # One more than steps, as Minari has infos: nothing has succeeded at the reset.
    group.create_group("infos")["success"] = np.concatenate([[False], episode.success])


def _space(observation: Mapping[str, NDArray[np.float32]]) -> str:
    boxes = {name: box_space(values) for name, values in observation.items()}
    if set(boxes) == {OBSERVATION}:
        return json.dumps(boxes[OBSERVATION])
    return json.dumps({"type": "Dict", "subspaces": boxes})
