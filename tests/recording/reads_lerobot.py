"""What LeRobot's own library makes of a data set, as JSON: run in an environment that has it.

python tests/recording/reads_lerobot.py FOLDER
"""

from __future__ import annotations

import json
import os
import sys
from typing import Any

os.environ["HF_HUB_OFFLINE"] = "1"


def main(folder: str) -> dict[str, Any]:
    import torch
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.datasets.utils import dataset_to_policy_features

    whole = LeRobotDataset("ours/set", root=folder)
    fps = whole.fps
    second = LeRobotDataset("ours/set", root=folder, episodes=[1])
    windows = LeRobotDataset("ours/set", root=folder, delta_timestamps={"action": [0.0, 1 / fps, 2 / fps]})
    batches = list(torch.utils.data.DataLoader(whole, batch_size=64, shuffle=False))
    return {
        "version": str(whole.meta._version),
        "episodes": whole.num_episodes,
        "frames": whole.num_frames,
        "fps": whole.fps,
        "robot": whole.meta.robot_type,
        "tasks": [whole[0]["task"], whole[len(whole) - 1]["task"]],
        "state": whole[100]["observation.state"].tolist(),
        "second": second[0]["observation.state"].tolist(),
        "second_frames": second.num_frames,
        "window": list(windows[10]["action"].shape),
        "batches": sum(len(batch["index"]) for batch in batches),
        "temperature": bool(torch.isnan(batches[0]["recording.temperature"]).all()),
        "features": sorted(dataset_to_policy_features(whole.meta.features)),
        "mean": whole.meta.stats["observation.state"]["mean"].tolist(),
        "stats": sorted(whole.meta.stats),
    }


if __name__ == "__main__":
    json.dump(main(sys.argv[1]), sys.stdout)
