"""A sweep trains every combination of values in a folder of its own, and goes on where it was."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.learning.training import Recipe
from allegro_twin.learning.training.sweeping import read_variants, train_variants
from tests.surfaces.cli.conftest import Run, command

__all__ = ["command"]  # A fixture.
TINY: dict[str, Any] = {
    "task": "Reach", "envs": 4, "rollout": 8, "round": 32, "steps": 32, "batch": 16, "epochs": 1, "hidden": (8,),
    "trials": 1, "environment": {"timestep": 0.003, "decimation": 60}, "log": [],
}  # fmt: skip


def written(folder: Path, text: str) -> Path:
    (folder / "values.yaml").write_text(text)
    return folder / "values.yaml"


def test_every_combination_is_a_recipe_and_the_last_key_changes_fastest(tmp_path: Path) -> None:
    path = written(tmp_path, "learning_rate: [0.001, 0.0005]\nenvironment.step: [0.1, 0.2]\nhidden: [[8], [16, 16]]\n")
    found = read_variants(path, Recipe.model_validate(TINY))
    assert [each.name for each in found[:3]] == [
        "learning_rate=0.001,environment.step=0.1,hidden=0",
        "learning_rate=0.001,environment.step=0.1,hidden=1",
        "learning_rate=0.001,environment.step=0.2,hidden=0",
    ]
    assert len(found) == 8
    last = found[-1].recipe
    assert (last.learning_rate, last.environment.step, last.hidden) == (0.0005, 0.2, (16, 16))
    assert (last.environment.decimation, last.envs) == (60, 4), "the rest is the recipe's"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seed: 3\n", "seed: a sweep needs a list of values, not 3"),
        ("seed: []\n", "seed: a sweep needs a list of values, not \\[\\]"),
        ("{}\n", "keys of a recipe, each with a list of values; this file has none"),
        ("sede: [1]\n", "values.yaml: sede=1: sede: unknown key; did you mean 'seed'"),
        ("environment.stepp: [0.1]\n", "environment.stepp: unknown key; did you mean 'step'"),
        ("task.x: [1]\n", "task.x: task has no parts"),
        ("seed: [1, 1]\n", "a key has the same value twice"),
    ],
)
def test_what_is_no_sweep_is_refused_in_a_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        read_variants(written(tmp_path, text), Recipe.model_validate(TINY))


@pytest.mark.slow
def test_a_sweep_trains_all_and_again_only_what_is_left(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("stable_baselines3", "torch", "onnx", "onnxruntime"):
        pytest.importorskip(name, reason="training needs the extra rl")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.yaml").write_text(json.dumps(TINY))
    written(tmp_path, "learning_rate: [0.001]\nseed: [0, 1]\n")
    words = ("train", "tiny.yaml", "--sweep", "values.yaml", "--episodes", 2)
    code, shown, errors = command(*words)
    assert (code, errors) == (0, "")
    folder = tmp_path / "runs" / "tiny-values"
    with (folder / "sweep.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["learning_rate"], row["seed"], row["steps"]) for row in rows] == [
        ("0.001", "0", "32"),
        ("0.001", "1", "32"),
    ]
    assert all(0.0 <= float(row["success, trained on"]) <= 1.0 for row in rows)
    assert "success, trained on" in " ".join(shown.split())
    report = folder / "learning_rate=0.001,seed=1" / "evaluation.json"
    before = report.stat().st_mtime_ns
    (folder / "learning_rate=0.001,seed=0" / "evaluation.json").unlink()
    assert command(*words)[0] == 0
    assert report.stat().st_mtime_ns == before, "it was judged again"
    assert (folder / "learning_rate=0.001,seed=0" / "evaluation.json").is_file()
    assert command(*words[:-1], 1)[0] == 0
    assert report.stat().st_mtime_ns > before, "of another number of episodes"
    code, _, errors = command("train", "tiny.yaml", "--jobs", 2)
    assert code == 2
    assert "--jobs 2 is for the trainings of a sweep: say --sweep FILE" in errors


def test_a_sweep_over_steps_keeps_its_values_beside_the_actions_that_were_trained(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3", reason="training needs the extra rl")
    variants = read_variants(written(tmp_path, "steps: [32, 40]\n"), Recipe.model_validate(TINY))
    rows = train_variants(variants, tmp_path / "out", 1)
    assert [(row["steps"], row["steps, trained"]) for row in rows] == [(32, 32), (40, 32)]
    with (tmp_path / "out" / "sweep.csv").open() as file:
        assert [(row["steps"], row["steps, trained"]) for row in csv.DictReader(file)] == [("32", "32"), ("40", "32")]


def test_a_training_that_diverges_has_that_in_its_row_and_the_others_go_on(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3", reason="training needs the extra rl")
    path = written(tmp_path, "learning_rate: [0.001, 1.0e+6]\nseed: [0, 1]\n")
    rows = train_variants(read_variants(path, Recipe.model_validate(TINY)), tmp_path / "out", 1)
    assert [row["learning_rate"] for row in rows] == [0.001, 0.001, 1e6, 1e6]
    assert [row.get("steps") for row in rows] == [32, 32, None, None]
    for row in rows[2:]:
        assert "the training diverged in the round after 0 actions" in row["error"]
        assert "choose a learning_rate below 1e+06" in row["error"]
    with (tmp_path / "out" / "sweep.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 4


def test_a_training_that_fails_has_its_error_in_its_row(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3", reason="training needs the extra rl")
    variants = read_variants(written(tmp_path, "seed: [0, 1]\n"), Recipe.model_validate(TINY))
    checkpoints = tmp_path / "out" / "seed=0" / "checkpoints"
    checkpoints.mkdir(parents=True)
    (checkpoints / "00001.zip").write_text("no checkpoint")
    first, second = train_variants(variants, tmp_path / "out", 1)
    assert "not a readable checkpoint" in first["error"]
    assert second["steps"] == 32
    assert "error" not in second
