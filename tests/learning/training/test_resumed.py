"""A training with rsl-rl that was cut off goes on as if nothing had happened, to the bit, on processors."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.randomise import Randomise
from allegro_twin.learning.training import Recipe, train

torch = pytest.importorskip("torch", reason="torch is not installed: pip install 'allegro-twin[rsl]'")
pytest.importorskip("rsl_rl", reason="rsl_rl is not installed: pip install 'allegro-twin[rsl]'")

RANDOM = Randomise.default().model_dump(exclude_none=True)
TASKS: dict[str, dict[str, Any]] = {
    "Reach": {"randomise": RANDOM},
    "Rotate": {"state": True, "randomise": RANDOM},
    "Reorient": {"goals": "yaw", "history": 2, "randomise": {"camera_delay": [1, 2], "camera_turn": [0.1, 0.1]}},
    "Grasp": {"objects": ["tennis_ball", "foam_brick"], "state": True, "touch": True, "randomise": RANDOM},
    "Lift": {"objects": ["foam_brick"]},
    "HoldDisturbed": {"objects": ["tennis_ball"]},
}


class Stop(Exception):
    pass


def recipe(task: str, **changes: Any) -> Recipe:
    """Three rounds of two updates; episodes that end within them, and that last over their ends."""
    given: dict[str, Any] = {
        "task": task, "learner": "rsl-rl", "environment": {"timestep": 0.003, "decimation": 26} | TASKS[task],
        "envs": 6, "rollout": 6, "steps": 216, "round": 72, "batch": 12, "epochs": 2, "hidden": [8], "trials": 1,
        "log_spread": -0.5, "learning_rate": 1e-3,
    }  # fmt: skip
    return Recipe(**given | changes)


def content(folder: Path) -> list[tuple[str, Any]]:
    """Everything in the last checkpoint but the seconds, as paths and values."""
    whole = torch.load(max(folder.glob("checkpoints/*.pt")), weights_only=True)
    whole["progress"].pop("seconds")
    return list(flat(whole, ""))


def flat(value: Any, path: str) -> Any:
    if isinstance(value, dict):
        for key, part in value.items():
            yield from flat(part, f"{path}/{key}")
    elif isinstance(value, list | tuple):
        for number, part in enumerate(value):
            yield from flat(part, f"{path}/{number}")
    else:
        yield path, value


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "curve.csv").open(newline="") as file:
        return [
            {name: value for name, value in row.items() if name not in ("seconds", "time/fps")}
            for row in csv.DictReader(file)
        ]


def same(one: Path, other: Path) -> None:
    first, second = content(one), content(other)
    assert [path for path, _ in first] == [path for path, _ in second]
    for (path, mine), (_, its) in zip(first, second, strict=True):
        np.testing.assert_array_equal(np.asarray(mine), np.asarray(its), err_msg=path)
    assert rows(one) == rows(other)


def cut_off(folder: Path, wanted: Recipe, after: int) -> None:
    def stop(steps: int, mean: float, rate: float) -> None:
        if steps > after:
            raise Stop

    with pytest.raises(Stop):
        train(wanted, folder, stop)


@pytest.mark.parametrize(
    "task", [pytest.param(task, marks=() if task == "Reach" else pytest.mark.slow) for task in TASKS]
)
def test_a_training_that_is_continued_is_the_one_that_was_not_interrupted(task: str, tmp_path: Path) -> None:
    wanted = recipe(task)
    train(wanted, tmp_path / "whole")
    for after in (72, 144 + 36 - 1):  # In the second round, and in the third.
        cut_off(tmp_path / "cut", wanted, after)
    assert int(rows(tmp_path / "cut")[-1]["steps"]) > 144, "nothing was done twice"
    trained = train(wanted, tmp_path / "cut")
    assert trained.progress.steps == 216
    same(tmp_path / "whole", tmp_path / "cut")


@pytest.mark.slow
def test_the_rate_that_adapts_goes_on_too(tmp_path: Path) -> None:
    wanted = recipe("Rotate", desired_kl=0.01)
    train(wanted, tmp_path / "whole")
    cut_off(tmp_path / "cut", wanted, 72)
    train(wanted, tmp_path / "cut")
    same(tmp_path / "whole", tmp_path / "cut")


def test_generators_outside_go_on_where_they_were(tmp_path: Path) -> None:
    """A task of a user's may draw from NumPy's or Python's own generator."""
    import random

    from allegro_twin.learning.training.rsl.rounds import _generators, _seed

    torch.save(_generators(), tmp_path / "states.pt")
    drawn = [(torch.rand(3).tolist(), np.random.normal(size=3).tolist(), random.random()) for _ in range(2)]
    _seed(torch.load(tmp_path / "states.pt", weights_only=True))
    again = [(torch.rand(3).tolist(), np.random.normal(size=3).tolist(), random.random()) for _ in range(2)]
    assert drawn == again


@pytest.mark.slow
def test_tensorboard_shows_the_training_without_a_seam(tmp_path: Path) -> None:
    name = "tensorboard.backend.event_processing.event_accumulator"
    events = pytest.importorskip(name, reason="tensorboard is not installed: pip install 'allegro-twin[rsl]'")
    wanted = recipe("Rotate")
    cut_off(tmp_path, wanted, 72)
    train(wanted, tmp_path)
    log = events.EventAccumulator(str(tmp_path / "tensorboard"))
    log.Reload()
    assert [each.step for each in log.Scalars("train/value_loss")] == [36, 72, 108, 144, 180, 216]
    table = {int(row["steps"]): row for row in rows(tmp_path) if row["return"]}
    shown = {each.step: each.value for each in log.Scalars("rollout/ep_rew_mean")}
    assert shown.keys() == table.keys()
    for step, value in shown.items():
        assert value == pytest.approx(float(table[step]["return"]), rel=1e-4)
    for name in ("train/entropy", "train/surrogate_loss", "train/learning_rate", "train/std", "rollout/ep_len_mean"):
        assert log.Scalars(name)
    assert log.Scalars("evaluation/success_rate")[-1].step == 216


@pytest.mark.slow
def test_a_checkpoint_of_other_environments_is_refused(tmp_path: Path) -> None:
    """The recipe is the same, and its task is not: another version of a user's own, say."""
    wanted = recipe("Rotate", steps=72)
    train(wanted, tmp_path)
    path = max(tmp_path.glob("checkpoints/*.pt"))
    whole = torch.load(path, weights_only=True)
    whole["learner"]["episodes"]["engine/task/turned"] = torch.zeros(5)
    torch.save(whole, path)
    with pytest.raises(ConfigError, match=r"the state's engine/task/turned has the shape \(5,\), and here it is"):
        train(recipe("Rotate", steps=144), tmp_path)
