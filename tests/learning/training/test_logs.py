"""Every learner writes the same logs, and one key of a recipe says which."""

from __future__ import annotations

import csv
import itertools
import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.learning.training import Recipe, train
from allegro_twin.learning.training.logs import LearningCurve

EXTRA = "training needs the extra rl, or rsl"
LEARNERS = ("stable-baselines3", "rsl-rl")
TINY: dict[str, Any] = {
    "task": "Reach", "envs": 4, "rollout": 8, "round": 64, "steps": 128, "batch": 16, "epochs": 2, "hidden": (8,),
    "trials": 1, "environment": {"timestep": 0.003, "decimation": 60},
}  # fmt: skip
"""Two rounds of two updates; an episode has 11 actions."""
OF_EVERY_LEARNER = {
    "train/value_loss", "train/entropy", "train/learning_rate", "train/std", "train/kl", "train/surrogate_loss",
    "time/fps", "terms/distance", "terms/diverged",
}  # fmt: skip


class Run:
    def __init__(self, **given: Any) -> None:
        self.given, self.rows, self.finished = given, list[tuple[int, dict[str, float]]](), False

    def log(self, values: dict[str, float], step: int) -> None:
        self.rows.append((step, dict(values)))

    def finish(self) -> None:
        self.finished = True


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[Run]:
    """A stand-in for `wandb`, with the runs that it was asked for."""
    begun: list[Run] = []
    fake = ModuleType("wandb")

    def init(**given: Any) -> Run:
        begun.append(Run(**given))
        return begun[-1]

    fake.init = init  # type: ignore[attr-defined]
    fake.Error = type("Error", (Exception,), {})  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "wandb", fake)
    return begun


def needs(learner: str) -> None:
    for name in ("torch", "onnx", "onnxruntime", "tensorboard", {"rsl-rl": "rsl_rl"}.get(learner, "stable_baselines3")):
        pytest.importorskip(name, reason=EXTRA)


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "curve.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("learner", LEARNERS)
@pytest.mark.slow
def test_all_logs_have_the_same_values_and_a_run_goes_on_with_its_training(
    learner: str, tmp_path: Path, runs: list[Run]
) -> None:
    needs(learner)
    events = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator", reason=EXTRA)
    folder = tmp_path / "mine"
    recipe = Recipe.model_validate(TINY | {"learner": learner, "log": ["tensorboard", "csv", "wandb"]})
    train(recipe, folder)
    (run,) = runs
    assert run.finished
    assert (run.given["dir"], run.given["name"], run.given["resume"]) == (str(folder), "mine", "allow")
    assert run.given["config"] == json.loads((folder / "recipe.json").read_text())
    shown = events.EventAccumulator(str(folder / "tensorboard"))
    shown.Reload()
    names = {*shown.Tags()["scalars"]}
    assert names >= OF_EVERY_LEARNER | {"rollout/ep_rew_mean", "rollout/success_rate", "evaluation/success_rate"}
    rows, logged = table(folder), {(step, name): value for step, row in run.rows for name, value in row.items()}
    for name in names:
        found = {each.step: each.value for each in shown.Scalars(name)}
        assert {step: value for (step, key), value in logged.items() if key == name} == pytest.approx(found)
        column = {"rollout/ep_rew_mean": "return", "rollout/ep_len_mean": "length", "rollout/success_rate": "success"}
        column["evaluation/success_rate"] = "evaluated"
        written = {int(row["steps"]): float(row[column.get(name, name)]) for row in rows if row[column.get(name, name)]}
        assert written.keys() == found.keys(), name
        for step, value in written.items():
            assert value == pytest.approx(found[step], rel=1e-4, abs=1e-6), name
        assert len(found) == len(shown.Scalars(name)), f"two values of {name} at one step"
    updates = [row for row in rows if not row["evaluated"]]
    assert [int(row["steps"]) for row in updates if row["train/value_loss"]] == [32, 64, 96, 128], "each its own losses"
    assert not [name for name in names if name.startswith("terms/_")]
    for before, after in itertools.pairwise(updates):
        steps, seconds = (float(after[name]) - float(before[name]) for name in ("steps", "seconds"))
        assert float(after["time/fps"]) == pytest.approx(steps / seconds, rel=1e-2)
    assert 0.0 < min(each.value for each in shown.Scalars("train/kl")) < 1.0
    assert 0.0 < shown.Scalars("terms/distance")[0].value < 0.2

    train(recipe.model_copy(update={"steps": 192, "log": ("wandb",)}), folder)
    assert [step for step, _ in runs[1].rows] == ([160, 192, 192])
    assert runs[0].given["id"] == runs[1].given["id"] == (folder / "wandb_id").read_text()
    assert table(folder) == rows, "no csv was asked for"


@pytest.mark.parametrize("learner", LEARNERS)
def test_without_logs_a_training_is_the_same_and_writes_none(learner: str, tmp_path: Path) -> None:
    needs(learner)
    short = TINY | {"learner": learner, "steps": 64}
    train(Recipe.model_validate(short), tmp_path / "with")
    train(Recipe.model_validate(short | {"log": []}), tmp_path / "without")
    assert not (tmp_path / "without" / "curve.csv").exists()
    assert not (tmp_path / "without" / "tensorboard").exists()
    import onnx

    one, other = (onnx.load(str(tmp_path / name / "policy.onnx")).graph for name in ("with", "without"))
    assert one == other


def test_a_log_whose_package_is_missing_is_named_before_anything_is_trained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    needs("stable-baselines3")
    monkeypatch.setitem(sys.modules, "wandb", None)
    recipe = Recipe.model_validate(TINY | {"log": ["wandb"]})
    with pytest.raises(ConfigError, match=r"training needs wandb: pip install 'allegro-twin\[wandb\]', or leave wandb"):
        train(recipe, tmp_path)
    assert not [*tmp_path.iterdir()]
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    with pytest.raises(ConfigError, match=r"training needs tensorboard: pip install 'allegro-twin\[rl\]', or leave"):
        train(Recipe.model_validate(TINY), tmp_path)


def test_a_run_that_cannot_begin_says_how_to_stay_offline(
    tmp_path: Path, runs: list[Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    needs("stable-baselines3")
    wandb: Any = sys.modules["wandb"]

    def refuse(**_: Any) -> None:
        raise wandb.Error("api_key not configured\nrun wandb login")

    monkeypatch.setattr(wandb, "init", refuse)
    with pytest.raises(ConfigError, match="log wandb: api_key not configured \\(WANDB_MODE=offline keeps"):
        train(Recipe.model_validate(TINY | {"log": ["wandb"]}), tmp_path)


def test_a_curve_takes_new_columns_and_forgets_what_lies_beyond_its_checkpoint(tmp_path: Path) -> None:
    path = tmp_path / "curve.csv"
    curve = LearningCurve(path, 0)
    curve.add({"steps": 10, "return": 1.5})
    curve.add({"steps": 20, "terms/speed": 0.25})
    with path.open("a") as file:
        file.write("30,cut")
    curve = LearningCurve(path, 20)
    curve.add({"steps": 30, "terms/speed": 0.5})
    assert [row["steps"] for row in table(tmp_path)] == ["10", "20", "30"]
    assert [row["terms/speed"] for row in table(tmp_path)] == ["", "0.25", "0.5"]
    assert [row["return"] for row in table(tmp_path)] == ["1.5", "", ""]
    LearningCurve(path, 10)
    assert [row["steps"] for row in table(tmp_path)] == ["10"]
