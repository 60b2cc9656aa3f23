"""The list of environments."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from typer.testing import CliRunner

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli.main import app
from tests.full_disk import full_disk
from tests.surfaces.cli.conftest import Run


def test_the_environments_are_listed_with_their_spaces_and_what_they_are_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("allegro_twin.surfaces.cli.console.console.width", 200, raising=False)
    text = " ".join(CliRunner().invoke(app, ["envs", "Reorient"]).stdout.split())
    for part in ("AllegroTwin/Reorient-v0", "observation 77", "16 in [-1, 1]", "privileged", "769"):
        assert part in text


def test_an_unknown_task_is_answered_with_the_nearest() -> None:
    result = CliRunner().invoke(app, ["envs", "Lfit"])
    assert isinstance(result.exception, ConfigError)
    assert "did you mean 'Lift'" in str(result.exception)


def test_episodes_are_kept_and_of_them_only_those_that_ended_well(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "quick.yaml").write_text("task: Pinch\nenvironment: {level: easy, timestep: 0.003, decimation: 100}\n")
    monkeypatch.chdir(tmp_path)
    code, shown, errors = command("collect", "quick.yaml", "set", "--episodes", 4, "--only-success")
    assert (code, errors) == (0, "")
    kept = json.loads((tmp_path / "set" / "meta" / "info.json").read_text())["total_episodes"]
    assert 0 < kept <= 4
    assert f"set/: {kept} episodes" in shown
    assert f"{kept} of 4 ended well" in shown


def test_episodes_of_a_recipe_that_trains_on_a_gpu_are_collected_on_processors(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = "environment: {level: easy, timestep: 0.003, decimation: 100, device: warp}"
    (tmp_path / "quick.yaml").write_text(f"task: Pinch\nlearner: rsl-rl\n{quick}\n")
    monkeypatch.chdir(tmp_path)
    code, shown, errors = command("collect", "quick.yaml", "set", "--episodes", 1)
    assert (code, errors) == (0, "")
    assert "set/: 1 episodes" in shown


def test_an_interruption_before_an_episode_is_whole_and_one_while_they_are_written_say_what_there_is(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    from allegro_twin.learning.environments import collect as module
    from allegro_twin.recording.exchange import environment_episodes as sets

    whole = sets.to_lerobot
    (tmp_path / "quick.yaml").write_text("task: Pinch\nenvironment: {level: easy, timestep: 0.003, decimation: 100}\n")
    monkeypatch.chdir(tmp_path)

    def at_once(*words: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        whole(*words)

    with monkeypatch.context() as patched:
        patched.setattr(sets, "to_lerobot", at_once)
        code, shown, errors = command("collect", "quick.yaml", "set", "--episodes", 2)
    assert (code, errors) == (130, "")
    assert "set/: 2 episodes" in shown

    def never(*words: Any, **more: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "collect_episodes", never)
    code, _, errors = command("collect", "quick.yaml", "none", "--episodes", 2)
    assert code == 130
    assert "no episode is whole yet, and nothing is written: the same command begins anew" in errors


def test_episodes_that_are_whole_are_kept_when_it_is_interrupted(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    from allegro_twin.learning.environments import collect as module

    collect_episodes, seeds = module.collect_episodes, list[int]()

    def until_the_third(*words: Any, seed: int) -> Any:
        seeds.append(seed)
        if len(seeds) == 3:
            raise KeyboardInterrupt
        return collect_episodes(*words, seed=seed)

    monkeypatch.setattr(module, "collect_episodes", until_the_third)
    monkeypatch.setattr("allegro_twin.surfaces.cli.learning.collect.TOGETHER", 2)
    (tmp_path / "quick.yaml").write_text("task: Pinch\nenvironment: {level: easy, timestep: 0.003, decimation: 100}\n")
    monkeypatch.chdir(tmp_path)
    code, shown, errors = command("collect", "quick.yaml", "set", "--episodes", 7, "--seed", 10)
    assert (code, seeds) == (130, [10, 12, 14])
    assert "4 of 7 episodes are whole" in errors
    assert "--seed 14 and --episodes 3" in errors
    assert json.loads((tmp_path / "set" / "meta" / "info.json").read_text())["total_episodes"] == 4
    assert "set/: 4 episodes" in shown


@pytest.mark.slow
@pytest.mark.parametrize("format", ["lerobot", "minari"])
def test_a_full_disk_costs_the_episodes_that_do_not_fit_and_no_others(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch, format: str
) -> None:
    (tmp_path / "quick.yaml").write_text("task: Pinch\nenvironment: {level: easy, timestep: 0.003, decimation: 100}\n")
    monkeypatch.chdir(tmp_path)
    words = ("--episodes", 8, "--seed", 10, "--format", format)
    assert command("collect", "quick.yaml", "all-v0", *words)[0] == 0
    largest = max(path.stat().st_size for path in (tmp_path / "all-v0").rglob("*") if path.is_file())
    with full_disk(round(0.8 * largest)):
        code, shown, errors = command("collect", "quick.yaml", "some-v0", *words)
    meta = "meta/info.json" if format == "lerobot" else "data/metadata.json"
    kept = json.loads((tmp_path / "some-v0" / meta).read_text())["total_episodes"]
    assert (code, 0 < kept < 8) == (2, True)
    assert f"some-v0/: {kept} episodes" in shown
    said = " ".join(errors.split())
    assert f"it has {kept} of 8 episodes: the same command with a folder on another disk" in said
    assert f"--seed {10 + kept} and --episodes {8 - kept} collects the rest" in said
    with full_disk(100):
        code, shown, errors = command("collect", "quick.yaml", "none-v0", *words)
    assert (code, shown, errors.count("\n")) == (2, "", 1)
    assert not (tmp_path / "none-v0").exists()


def test_a_task_is_done_without_learning_and_each_episode_is_a_row(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "turn.yaml").write_text("task: Rotate\nenvironment: {decimation: 20, objects: [ball]}\n")
    (tmp_path / "mpc.yaml").write_text("{method: mppi, samples: 4, horizon: 0.2, knots: 2, iterations: 1}\n")
    monkeypatch.chdir(tmp_path)
    code, shown, errors = command(
        "mpc", "turn.yaml", "--episodes", 2, "--seconds", 0.2, "--settings", "mpc.yaml", "--seed", 7
    )
    assert (code, errors) == (0, "")
    assert "mppi, 4 samples over 0.2 s; seeds from 7, in lockstep" in shown
    assert shown.count("│ ball") == 2
    (tmp_path / "mpc.yaml").write_text("{sampels: 4}\n")
    code, _, errors = command("mpc", "turn.yaml", "--settings", "mpc.yaml")
    assert code == 2
    assert "did you mean 'samples'" in errors
    assert command("mpc", "turn.yaml", "--seconds", 0)[0] == 2


def test_an_interrupted_row_of_episodes_shows_those_that_have_ended_and_its_film(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    from allegro_twin.learning.mpc.sampling import SamplingMpc

    def plan(self: SamplingMpc, state: Any) -> Any:
        plans.append(1)
        if len(plans) > 3:
            raise KeyboardInterrupt
        return np.zeros(16, np.float32)

    plans: list[int] = []
    monkeypatch.setattr(SamplingMpc, "plan", plan)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mpc.yaml").write_text("{samples: 2, horizon: 0.2, knots: 2}\n")
    code, shown, errors = command("mpc", "Reorient", "--seconds", 0.08, "--settings", "mpc.yaml", "--film", "seen.mp4")
    assert code == 130
    assert shown.count("│ cube") == 1
    assert " 0 │" in shown  # Goals are whole numbers.
    assert errors == "interrupted: 1 of 4 episodes have ended; what came until then is in seen.mp4\n"
    with av.open("seen.mp4") as film:
        assert sum(1 for _ in film.decode(video=0)) == 3


def test_the_name_of_a_task_is_the_task_in_the_fingertips_and_a_recipe_on_the_palm_says_so_in_its_name(
    command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    from allegro_twin.learning.mpc import episodes

    asked: list[str] = []

    def run_none(task: str, environment: Any, *_: Any, **__: Any) -> list[Any]:
        asked.append(environment.palm)
        return []

    monkeypatch.setattr(episodes, "run_episodes", run_none)
    assert [command("mpc", name)[0] for name in ("Rotate", "rotate", "rotate_on_palm")] == [0, 0, 0]
    assert asked == ["forbidden", "forbidden", "allowed"]
