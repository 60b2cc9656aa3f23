"""LeRobot's own recording loop drives a hand on two backends, and its library reads what was recorded.

Run in an environment with lerobot 0.4.4, allegro-twin and this plugin: `python check.py`. Ends with a line a check.
"""

from __future__ import annotations

import os
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ["HF_HUB_OFFLINE"] = "1"
os.environ.setdefault("HF_HOME", tempfile.mkdtemp())

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.utils import hw_to_dataset_features
from lerobot.processor import make_default_processors
from lerobot.robots.config import RobotConfig
from lerobot.robots.utils import make_robot_from_config
from lerobot.scripts.lerobot_record import record_loop
from lerobot.teleoperators.config import TeleoperatorConfig
from lerobot.teleoperators.teleoperator import Teleoperator
from lerobot.utils.import_utils import register_third_party_plugins

FPS = 30


@TeleoperatorConfig.register_subclass("wave")
@dataclass(kw_only=True)
class WaveConfig(TeleoperatorConfig):
    """A teleoperator that bends the fingers, a little beyond a limit too."""


class Wave(Teleoperator):
    config_class, name = WaveConfig, "wave"

    def __init__(self, config: WaveConfig, keys: list[str], home: np.ndarray, most: float) -> None:
        super().__init__(config)
        self._most = most
        self._keys, self._home, self._k, self._on = keys, home, 0, False

    @property
    def action_features(self) -> dict[str, type]:
        return dict.fromkeys(self._keys, float)

    @property
    def feedback_features(self) -> dict[str, type]:
        return {}

    @property
    def is_connected(self) -> bool:
        return self._on

    def connect(self, calibrate: bool = True) -> None:
        self._on = True

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None: ...
    def configure(self) -> None: ...

    def get_action(self) -> dict[str, Any]:
        self._k += 1
        goal = self._home + 0.2 * np.sin(self._k / FPS * np.pi)
        goal[0] = self._most + 0.015  # Beyond its limit as a joint at its stop: what is recorded is the limit.
        return dict(zip(self._keys, goal.tolist(), strict=True))

    def send_feedback(self, feedback: dict[str, Any]) -> None: ...
    def disconnect(self) -> None:
        self._on = False


def check(backend: str, folder: Path) -> str:
    kind = RobotConfig.get_choice_class("allegro")
    robot = make_robot_from_config(kind(config=backend, id=backend, calibration_dir=folder / "calibration"))
    features = hw_to_dataset_features(robot.action_features, "action") | hw_to_dataset_features(
        robot.observation_features, "observation"
    )
    dataset = LeRobotDataset.create(
        f"me/{backend}", FPS, root=folder / "set", robot_type=robot.name, features=features, use_videos=False
    )
    from allegro_twin.hands import load_posture

    home = np.array(load_posture("home", robot.spec))
    teleop = Wave(WaveConfig(id="w", calibration_dir=folder / "calibration"), list(robot.action_features), home,
                  robot.spec.upper[0])  # fmt: skip
    robot.connect()
    teleop.connect()
    events = {"exit_early": False, "rerecord_episode": False, "stop_recording": False}
    for _ in range(2):
        record_loop(robot, events, FPS, *make_default_processors(), dataset, teleop, control_time_s=2,
                    single_task="bend the fingers")  # fmt: skip
        dataset.save_episode()
    robot.disconnect()
    assert not robot.is_connected
    dataset.finalize()
    again = LeRobotDataset(f"me/{backend}", root=folder / "set")
    assert again.num_episodes == 2
    assert again.num_frames > 0.2 * 2 * 2 * FPS, again.num_frames
    states = np.array([again[k]["observation.state"].numpy() for k in range(len(again))])
    actions = np.array([again[k]["action"].numpy() for k in range(len(again))])
    n = robot.spec.n_joints
    assert np.allclose(actions[:, 0], robot.spec.upper[0]), actions[:, 0]
    error = np.abs(states[FPS:, 1:n] - actions[FPS:, 1:n]).max()
    moved = np.ptp(states[FPS:, 2])
    assert moved > 0.2, moved
    assert error < 0.25, error
    return f"{backend}: 2 episodes, {again.num_frames} frames, moved {moved:.2f} rad, behind by {error:.2f} rad at most"


def main() -> None:
    register_third_party_plugins()
    for backend in sys.argv[1:] or ["sim_right", "can_virtual"]:
        with tempfile.TemporaryDirectory() as folder:
            print(check(backend, Path(folder)))


if __name__ == "__main__":
    main()
