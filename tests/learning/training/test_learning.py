"""A training ends with the same policy however often it was killed, and its files say what they are."""

from __future__ import annotations

import csv
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.training import Recipe, load_recipe, train
from allegro_twin.learning.training.progress import VERSION

pytest.importorskip("torch", reason="training needs the extra rl")
for name in ("stable_baselines3", "onnx", "onnxruntime", "tensorboard"):
    pytest.importorskip(name, reason="training needs the extra rl")

ROOT = Path(__file__).resolve().parents[3]
SMALL: dict[str, Any] = {
    "task": "Reach", "envs": 8, "rollout": 16, "round": 256, "steps": 768, "batch": 64, "epochs": 2, "hidden": (16, 16),
    "trials": 2, "environment": {"timestep": 0.003},
}  # fmt: skip


def recipe(**changes: Any) -> Recipe:
    return Recipe.model_validate(SMALL | changes)


def weights(folder: Path) -> dict[str, Any]:
    """Everything that the policy and its optimiser have learned, as it is in the last checkpoint."""
    import torch

    path = max(folder.glob("checkpoints/*.zip"))
    found: dict[str, Any] = {}
    with zipfile.ZipFile(path) as archive:
        for member in ("policy.pth", "policy.optimizer.pth"):
            with archive.open(member) as file:
                found[member] = torch.load(file, weights_only=True)
    return found


def curve(folder: Path) -> list[dict[str, str]]:
    with (folder / "curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        row.pop("seconds")
        row.pop("time/fps", None)
    return rows


def same(first: Any, second: Any) -> None:
    if isinstance(first, dict):
        assert first.keys() == second.keys()
        for key, value in first.items():
            same(value, second[key])
    elif isinstance(first, list | tuple):
        for one, other in zip(first, second, strict=True):
            same(one, other)
    else:
        np.testing.assert_array_equal(np.asarray(first), np.asarray(second))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training that nobody disturbed."""
    folder = tmp_path_factory.mktemp("whole")
    train(recipe(), folder)
    return folder


def test_a_training_that_is_continued_is_the_one_that_was_not_interrupted(whole: Path, tmp_path: Path) -> None:
    class Stop(Exception):
        pass

    def stop(steps: int, mean: float, rate: float) -> None:
        if steps > 400:  # In the middle of the second round.
            raise Stop

    with pytest.raises(Stop):
        train(recipe(), tmp_path, stop)
    assert [path.name for path in (tmp_path / "checkpoints").iterdir()] == ["00001.zip"]
    assert int(curve(tmp_path)[-1]["steps"]) > 256, "nothing was done twice"
    trained = train(recipe(), tmp_path)
    assert trained.progress.steps == 768
    same(weights(whole), weights(tmp_path))
    assert curve(whole) == curve(tmp_path)


@pytest.mark.long
def test_after_a_sigkill_the_same_command_goes_on(whole: Path, tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(json.dumps(SMALL))
    command = [sys.executable, "-m", "allegro_twin", "train", "small.yaml", "--out", "run", "--episodes", "2"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen([*command, "--no-video"], cwd=tmp_path, env=environment, stderr=subprocess.DEVNULL)
    while not (tmp_path / "run" / "checkpoints" / "00001.zip").is_file():
        assert process.poll() is None, "it ended before it could be killed"
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert not (tmp_path / "run" / "policy.onnx").exists()
    done = subprocess.run([*command, "--no-video"], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "768 actions" in done.stdout
    same(weights(whole), weights(tmp_path / "run"))
    assert curve(whole) == curve(tmp_path / "run")


def test_the_exported_policy_acts_as_the_trained_one_and_carries_its_card(whole: Path) -> None:
    from stable_baselines3 import PPO

    from allegro_twin.learning.policy.loading import load_policy

    exported = load_policy(whole / "policy.onnx")
    assert (exported.card.task, exported.card.side, exported.card.mode) == ("AllegroTwin/Reach-v0", "right", "delta")
    assert exported.card.note.startswith("PPO, seed 0, 768 actions")
    keywords: dict[str, Any] = {"policy": str(whole / "policy.onnx")}
    assert HandEnv("Reach", **keywords).engine.settings == Recipe(**SMALL).environment
    last = whole / "checkpoints" / "00003.zip"
    model = PPO.load(str(last), device="cpu")
    rng = np.random.default_rng(0)
    seen = {name: rng.normal(size=(64, *space.shape)).astype(np.float32) * 0.1
            for name, space in model.observation_space.spaces.items()}  # fmt: skip
    wanted = model.predict(seen, deterministic=True)[0]
    np.testing.assert_allclose(exported.policy(seen), wanted, atol=1e-5)
    np.testing.assert_array_equal(load_policy(last, trust=True).policy(seen), wanted)
    far = {name: 100 * value for name, value in seen.items()}
    assert np.abs(exported.policy(far)).max() <= 1.0


@pytest.mark.parametrize("task", ["Reach", pytest.param("Rotate", marks=pytest.mark.slow)])
def test_with_a_state_the_critic_sees_it_and_the_exported_policy_does_not_need_it(task: str, tmp_path: Path) -> None:
    import torch
    from stable_baselines3 import PPO

    from allegro_twin.learning.policy.loading import load_policy

    environment = {"timestep": 0.003, "state": True}
    trained = train(recipe(task=task, environment=environment, steps=256), tmp_path)
    model = PPO.load(str(tmp_path / "checkpoints" / "00001.zip"), device="cpu")
    rng = np.random.default_rng(0)
    seen = {name: rng.normal(size=(8, *space.shape)).astype(np.float32) * 0.1
            for name, space in model.observation_space.spaces.items()}  # fmt: skip
    other = seen | {"state": seen["state"] + 1.0}
    action = model.predict(seen, deterministic=True)[0]
    np.testing.assert_array_equal(action, model.predict(other, deterministic=True)[0])
    values = [model.policy.predict_values({k: torch.from_numpy(v) for k, v in each.items()}) for each in (seen, other)]
    assert float((values[0] - values[1]).detach().abs().min()) > 1e-6
    exported = load_policy(trained.policy).policy
    hand = {name: value for name, value in seen.items() if name != "state"}
    np.testing.assert_allclose(exported(hand), action, atol=1e-5)


def test_the_normalisation_knows_everything_that_was_seen(whole: Path) -> None:
    policy = weights(whole)["policy.pth"]
    assert float(policy["features_extractor.count"]) == 768
    assert 0 < policy["features_extractor.variance"].max() < 10


def test_nothing_is_left_to_do_for_a_finished_training(whole: Path) -> None:
    before = weights(whole)
    told: list[int] = []
    trained = train(recipe(), whole, lambda steps, mean, rate: told.append(steps))
    assert told == []
    assert trained.progress.rounds == 3
    same(before, weights(whole))


def test_fewer_steps_than_were_trained_are_refused_and_more_go_on(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "run")
    before = (tmp_path / "run" / "recipe.json").read_text()
    with pytest.raises(
        ConfigError, match="is a training of 768 actions already, and steps are 300: give more steps, or"
    ):
        train(recipe(steps=300), tmp_path / "run")
    assert (tmp_path / "run" / "recipe.json").read_text() == before
    assert train(recipe(steps=1024), tmp_path / "run").progress.steps == 1024
    assert json.loads((tmp_path / "run" / "recipe.json").read_text())["steps"] == 1024


def test_a_training_shorter_than_a_round_goes_on_to_the_steps_that_are_asked_for(tmp_path: Path) -> None:
    assert train(recipe(steps=128), tmp_path).progress.steps == 128
    trained = train(recipe(steps=256), tmp_path)
    assert (trained.progress.rounds, trained.progress.steps) == (2, 256)
    assert [int(row["steps"]) for row in curve(tmp_path) if row["evaluated"]] == [128, 256]


def test_a_full_disk_is_one_line_and_the_same_command_goes_on(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = Path.write_bytes

    def full(path: Path, data: Any) -> int:
        if "00002" in path.name:
            write(path, bytes(data)[:100])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(path, data)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        with pytest.raises(RecordingError) as caught:
            train(recipe(), tmp_path)
    assert str(caught.value) == (
        f"the disk of {tmp_path} is full: make room there, and the same command goes on from checkpoint 1"
    )
    train(recipe(), tmp_path)
    same(weights(whole), weights(tmp_path))
    assert curve(whole) == curve(tmp_path)


def test_a_log_that_finds_the_disk_full_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    record_writer = pytest.importorskip("tensorboard.summary.writer.record_writer")

    def full(*given: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(record_writer.RecordWriter, "write", full)
    with pytest.raises(RecordingError, match="is full: make room there, and the same command begins anew"):
        train(recipe(log=("tensorboard",)), tmp_path)
    assert "Traceback" not in capfd.readouterr().err


def test_a_folder_of_another_training_is_refused_with_the_difference(whole: Path) -> None:
    with pytest.raises(ConfigError, match=r"is a training with seed 0, not 1: choose another folder"):
        train(recipe(seed=1), whole)


def test_a_checkpoint_from_another_version_is_refused_in_one_line(whole: Path, tmp_path: Path) -> None:
    old = tmp_path / "checkpoints" / "00001.zip"
    old.parent.mkdir()
    with zipfile.ZipFile(whole / "checkpoints" / "00001.zip") as source, zipfile.ZipFile(old, "w") as target:
        for member in source.namelist():
            content = source.read(member)
            if member == "training.json":
                content = json.dumps(json.loads(content) | {"version": 0}).encode()
            target.writestr(member, content)
    with pytest.raises(ConfigError) as caught:
        train(recipe(), tmp_path)
    assert str(caught.value) == (
        f"{old} is a checkpoint of version 0; this package continues {VERSION}: train anew in another folder"
    )
    old.write_bytes(b"half a file")
    with pytest.raises(ConfigError, match="not a readable checkpoint"):
        train(recipe(), tmp_path)


def test_rounds_are_whole_updates() -> None:
    assert (recipe().update, recipe().round_steps, recipe().rounds) == (128, 256, 3)
    assert recipe(round=200).round_steps == 256
    assert (recipe(steps=1).rounds, recipe(steps=1).round_steps) == (1, 128)


@pytest.mark.slow
def test_goals_go_farther_from_round_to_round_and_arrive_where_they_should(tmp_path: Path) -> None:
    from allegro_twin.learning.training.sb3 import ppo as learning

    few = recipe(task="Reorient", environment={"timestep": 0.003}, envs=2, rollout=4, steps=16, round=8, batch=8,
                 trials=1, farthest=(0.4, 0.8))  # fmt: skip
    seen: list[float] = []
    original = learning._round

    def watched(model: Any, env: Any, *rest: Any) -> None:
        original(model, env, *rest)
        seen.append(env.env.engine.task.farthest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learning, "_round", watched)
        train(few, tmp_path)
    assert seen == [0.4, 0.8]


def test_recipes_ship_for_tasks_and_wrong_names_are_answered_with_the_nearest() -> None:
    grasp = load_recipe("grasp_easy")
    assert grasp.environment.position_noise == 0.015
    assert not set(grasp.held_out) & set(grasp.environment.objects or ())
    assert load_recipe("reach", seed=4).seed == 4
    assert load_recipe("grasp_easy", side="left").environment.side == "left"
    assert load_recipe("lift").task == "Lift"
    assert load_recipe("lift", side="left").environment.side == "left"
    with pytest.raises(ConfigError, match="no task or recipe named 'Grap'; did you mean 'Grasp'"):
        load_recipe("Grap")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": 0}, "--steps: steps: input should be greater than or equal to 1, not 0"),
        ({"envs": 0}, "--envs: envs: input should be greater than or equal to 1, not 0"),
        ({"log": ["tensorbord"]}, r"--log: log\.0: input should be 'tensorboard', 'csv' or 'wandb', not 'tensorbord'"),
        ({"side": "middle"}, r"--side: environment\.side: input should be 'right' or 'left', not 'middle'"),
    ],
)
def test_a_wrong_option_is_named_and_not_the_recipe(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=f"^{message}"):
        load_recipe("Reach", **changes)


def test_a_mini_batch_is_at_most_an_update_and_nothing_is_warned_of(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        train(recipe(batch=1024, steps=128, log=()), tmp_path / "large")
        train(recipe(batch=100, steps=128, log=()), tmp_path / "odd")
    train(recipe(batch=128, steps=128, log=()), tmp_path / "whole")
    same(weights(tmp_path / "large"), weights(tmp_path / "whole"))


def test_without_the_extra_the_error_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(ConfigError, match=r"training needs stable_baselines3: pip install 'allegro-twin\[rl\]'"):
        train(recipe(), tmp_path)


def test_a_task_by_its_name_with_another_hand_has_the_defaults_for_that_hand() -> None:
    recipe = load_recipe("Reach", hand="model_o", steps=1000)
    assert (recipe.environment.hand, recipe.environment.timestep, recipe.steps) == ("model_o", 0.001, 1000)
    assert load_recipe("Reach", hand="allegro").environment == load_recipe("Reach").environment.model_copy(
        update={"hand": "allegro"}
    )
