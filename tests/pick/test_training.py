"""A network learns `ArmPick` from its script: the same to the bit however often it is killed, and judged fairly."""

from __future__ import annotations

import errno
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import allegro_twin.gym
from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.assets import data_root
from allegro_twin.learning.policy.card import ARM_PICK
from allegro_twin.learning.policy.loading import load_policy
from allegro_twin.learning.training.settings import load_recipe
from allegro_twin.pick.card import load_pick_policy
from allegro_twin.pick.env import ArmPick
from allegro_twin.pick.recipe import PickRecipe, load_pick_recipe
from allegro_twin.pick.report import check_pick_policy
from allegro_twin.pick.rollouts import ALWAYS, EpisodeOrder, evaluate_pick, roll_out
from allegro_twin.pick.settings import PickSettings
from allegro_twin.surfaces.cli import console
from allegro_twin.surfaces.cli.main import main

SHORT: dict[str, Any] = {"control": "grasp", "objects": ("apple",), "seconds": 1.0}
SHIPPED = data_root() / "conf" / "policies" / "arm_pick_right.onnx"


def recipe(**more: Any) -> PickRecipe:
    return PickRecipe.model_validate(
        {"task": "ArmPick", "environment": SHORT, "rounds": 2, "episodes": 2, "updates": 20, "last_updates": 20,
         "hidden": (16,), "log": ["csv"], "trials": 1, "envs": 1} | more
    )  # fmt: skip


class Killed(Exception):
    """In place of a signal."""


def train(given: PickRecipe, folder: Path, kept: Callable[[int], None] = lambda rounds: None) -> bytes:
    """All weights of the policy's file."""
    pytest.importorskip("torch")
    from allegro_twin.learning.training.onnx_policy import read_onnx_network
    from allegro_twin.pick.training import train_pick

    network = read_onnx_network(train_pick(given, folder, kept=kept).policy)
    layers = [part.detach().numpy() for layer in network.layers for part in layer.parameters()]
    return b"".join(part.tobytes() for part in (network.mean, network.scale, *layers))


@pytest.mark.slow
def test_a_training_that_was_killed_after_a_round_ends_as_one_that_was_not_whatever_the_processes(
    tmp_path: Path,
) -> None:
    long: dict[str, Any] = {"rounds": 3, "episodes": 1}
    whole = train(recipe(**long), tmp_path / "whole")

    def kill(rounds: int) -> None:
        if rounds == 2:
            raise Killed

    with pytest.raises(Killed):
        train(recipe(**long), tmp_path / "killed", kill)
    seen: list[int] = []
    assert train(recipe(envs=2, **long), tmp_path / "killed", seen.append) == whole
    assert seen == [2, 3]
    assert train(recipe(**long), tmp_path / "killed", seen.append) == whole
    assert seen == [2, 3, 3]
    assert train(recipe(seed=1, **long), tmp_path / "other") != whole
    for change in ({"seed": 1}, {"hidden": (8,)}, {"environment": SHORT | {"off": 0.0}}):
        with pytest.raises(ConfigError, match=f"is a training with {next(iter(change))} .*: choose another folder"):
            train(recipe(**long | change), tmp_path / "whole")
    cut = tmp_path / "whole" / "checkpoints" / "00002.npz"
    cut.write_bytes(cut.read_bytes()[:200])
    with pytest.raises(ConfigError, match=r"00002.npz: not a readable checkpoint \(.*\): choose another folder"):
        train(recipe(**long), tmp_path / "whole")
    cut.with_suffix(".pt").touch()
    with pytest.raises(ConfigError, match=r"is a training of another task \(00002.pt\): choose another folder"):
        train(recipe(**long), tmp_path / "whole")


@pytest.mark.slow
def test_the_script_is_asked_in_every_state_and_leads_until_it_is_told(tmp_path: Path) -> None:
    train(recipe(), tmp_path)
    policy, settings = tmp_path / "policy.onnx", PickSettings(**SHORT)
    both, script, network = (
        roll_out(settings, [EpisodeOrder(7, until)], policy, keep=True, processes=0) for until in (5, ALWAYS, 0)
    )
    limit = ArmPick(**SHORT).episodes.limit
    assert [len(each.observed) for each in (both, script, network)] == [limit] * 3
    np.testing.assert_array_equal(both.observed[:6], script.observed[:6])
    assert not np.array_equal(both.observed[6], script.observed[6])
    np.testing.assert_array_equal(network.observed[0], script.observed[0])
    assert script.objects == ("apple",)
    train(recipe(seed=1), tmp_path / "other")
    policy.write_bytes((tmp_path / "other" / "policy.onnx").read_bytes())
    other = roll_out(settings, [EpisodeOrder(7, 0)], policy, keep=True, processes=0)
    assert not np.array_equal(other.observed[1], network.observed[1]), "a file that was written anew is read anew"
    noisy = roll_out(settings, [EpisodeOrder(7, ALWAYS, 0.1)], None, keep=True, processes=0)
    assert not np.array_equal(noisy.observed[1], script.observed[1])
    np.testing.assert_array_equal(noisy.taught[0], script.taught[0])


@pytest.mark.slow
def test_a_policy_file_says_where_it_was_trained_and_an_environment_is_made_of_that(tmp_path: Path) -> None:
    train(recipe(), tmp_path)
    policy = tmp_path / "policy.onnx"
    env: Any = gymnasium.make(allegro_twin.gym.PICK, policy=policy, off=0.0).unwrapped
    assert (env.settings.control, env.settings.objects, env.settings.off) == ("grasp", ("apple",), 0.0)
    for keywords, message in (
        ({"control": "joints"}, "was trained with control grasp, not joints: leave out control"),
        ({"hand": "leap"}, "was trained with hand allegro, not leap: leave out hand"),
        ({"policy": 3}, "policy is the path of a policy's file, or the name of one that ships, not 3"),
        ({"policy": "lift_right"}, "is a policy of AllegroTwin/Lift-v0, not of AllegroTwin/ArmPick-v0"),
    ):
        with pytest.raises(ConfigError, match=message):
            ArmPick(**{"policy": policy} | keywords)
    with pytest.raises(ConfigError, match="is a policy of ArmPick, which moves an arm with its hand: it runs in its"):
        load_policy(policy)


@pytest.mark.slow
def test_episodes_of_an_evaluation_are_those_of_the_single_environment() -> None:
    found = evaluate_pick(PickSettings(objects=("apple", "mug"), control="grasp"), 2, None, seed=5, processes=0)
    assert found.success.tolist() == [True, True]
    env = ArmPick(objects=("apple", "mug"), control="grasp")
    assert found.objects == tuple(env.reset(seed=5 + k)[1]["object"] for k in range(2))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"held_out": ["apple"]}, "held_out: apple is among the objects of the training: leave it out of one of them"),
        ({"held_out": ["aple"]}, "held_out: no object named 'aple'; did you mean 'apple'"),
        ({"rounds": 0}, "rounds: input should be greater than or equal to 1, not 0"),
        ({"rounds": 1000, "episodes": 91}, "1000 rounds of 91 episodes are more than 90,000 episodes"),
        ({"seed": 10_000}, "seed: input should be less than or equal to 9999"),
        ({"environment": {"control": "hands"}}, "environment.control: input should be 'joints' or 'grasp'"),
        ({"steps": 5}, "steps"),
    ],
)
def test_what_no_training_can_be_is_refused_with_the_file_and_the_key(
    tmp_path: Path, given: dict[str, Any], message: str
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(json.dumps({"task": "ArmPick"} | given))
    with pytest.raises(ConfigError, match=f"mine.yaml: .*{message}"):
        load_pick_recipe(str(path))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"environment": SHORT, "held_out": ["mug"]}, "held_out: mug is among the objects that the policy was trained"),
        ({"environment": {"control": "grasp", "objects": ["lemon"]}}, "objects: the policy was not trained on lemon"),
        ({"environment": {"control": "grasp", "turn": 0.2}}, "trained with turn 0.1, these environments have 0.2"),
    ],
)
def test_an_evaluation_calls_nothing_unseen_or_known_that_is_not(given: dict[str, Any], message: str) -> None:
    pytest.importorskip("onnxruntime")
    with pytest.raises(ConfigError, match=message):
        check_pick_policy(SHIPPED, PickRecipe.model_validate({"task": "ArmPick"} | given))


@pytest.mark.slow
def test_a_held_out_object_that_the_hand_does_not_take_is_told_before_the_first_episode(tmp_path: Path) -> None:
    given = recipe(environment=SHORT | {"side": "left"}, held_out=("mug",))
    with pytest.raises(ConfigError, match=r"^recipe: held_out: ArmPick has no mug for allegro_left"):
        train(given, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_full_disk_is_told_with_what_the_same_command_does_then(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("torch")
    from allegro_twin.pick import imitation

    def full(*given: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(imitation, "_write", full)
    with pytest.raises(RecordingError, match="is full: make room there, and the same command begins anew"):
        train(recipe(), tmp_path)


def test_a_recipe_is_a_file_a_name_that_ships_or_the_task_and_of_no_other_task(tmp_path: Path) -> None:
    assert load_pick_recipe("ArmPick", seed=3, side="left", log=None) == PickRecipe(
        task="ArmPick", seed=3, environment=PickSettings(side="left")
    )
    shipped = load_pick_recipe("arm_pick", hand="leap")
    assert shipped is not None
    assert (shipped.environment.control, shipped.environment.hand) == ("grasp", "leap")
    for other in ("Lift", "lift", "mine:Task", "nothing"):
        assert load_pick_recipe(other) is None
    for name in ("ArmPick", "arm_pick"):
        with pytest.raises(ConfigError, match="ArmPick is a single environment: train and evaluate take it"):
            load_recipe(name)


def test_no_two_seeds_share_an_episode_and_no_evaluation_has_one() -> None:
    seeds = [PickRecipe(task="ArmPick", seed=seed, rounds=900, episodes=100).training_seeds() for seed in (0, 1, 9999)]
    assert not set(seeds[0]) & set(seeds[1])
    assert seeds[2].stop < 1_000_000_000


def test_its_id_is_that_of_its_cards() -> None:
    assert allegro_twin.gym.PICK == ARM_PICK


def ask(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    """Exit code, output and errors of `allegro-twin WORDS`."""
    monkeypatch.setattr(console.console, "width", 200)
    monkeypatch.setattr("sys.argv", ["allegro-twin", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        main()
    captured = capfd.readouterr()
    return int(ended.value.code or 0), captured.out, " ".join(captured.err.split())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("train", "ArmPick", "--steps", 5), "--steps 5 is for tasks with a batch, and ArmPick has none: leave it out"),
        (("train", "arm_pick", "--device", "warp"), "--device warp is for tasks with a batch"),
        (("train", "arm_pick", "--seed", 10_000), "--seed: seed: input should be less than or equal to 9999"),
        (("evaluate", "lift_right", "arm_pick"), "is a policy of AllegroTwin/Lift-v0, not of AllegroTwin/ArmPick-v0"),
        (("evaluate", "lift_right", "arm_pick", "--can", 3), "--can 3: an episode of ArmPick has an arm"),
        (("evaluate", "arm_pick_right", "Lift"), "is a policy of ArmPick, which moves an arm with its hand"),
        (("evaluate", "arm_pick_right", "nothing.yaml"), "no such recipe file"),
        (("train", "arm_pik"), "no task or recipe named 'arm_pik'; did you mean 'arm_pick'"),
        (("evaluate", "arm_pick_right", "ArmPick"), "was trained with control grasp, these environments have joints"),
        (("mpc", "arm_pick"), "ArmPick is a single environment: train and evaluate take it"),
    ],
)  # fmt: skip
def test_a_command_says_what_arm_pick_does_not_take(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], words: tuple[object, ...], message: str
) -> None:
    code, _, errors = ask(monkeypatch, capfd, *words)
    assert code == 2
    assert message in errors


@pytest.mark.slow
def test_a_training_and_an_evaluation_show_the_policy_beside_the_script_in_the_same_episodes(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    pytest.importorskip("torch")
    path, out = tmp_path / "mine.yaml", tmp_path / "out"
    mine = {"environment": SHORT | {"seconds": 7.0}, "held_out": ["mug"], "rounds": 1, "episodes": 1}
    path.write_text(json.dumps(json.loads(recipe(**mine).model_dump_json(exclude_unset=True))))
    code, output, _ = ask(monkeypatch, capfd, "train", path, "--out", out, "--episodes", 1, "--no-video")
    assert code == 0
    found = json.loads((out / "evaluation.json").read_text())
    assert {name: each["script"]["objects"] for name, each in found.items()} == {
        "trained on": {"apple": [1, 1]}, "held out": {"mug": [1, 1]},
    }  # fmt: skip
    assert found["trained on"]["policy"]["rate"] == 0.0
    assert "script" in output
    film = tmp_path / "film.mp4"
    code, output, errors = ask(
        monkeypatch, capfd, "evaluate", out / "policy.onnx", path, "--episodes", 1, "--seed", 100_000, "--film", film
    )
    assert code == 0
    assert "seeds 100000 to 100000: some are those of the training" in errors
    assert film.stat().st_size > 1000


@pytest.mark.slow
def test_the_policy_that_ships_picks_what_it_was_trained_on() -> None:
    settings = load_pick_policy(SHIPPED).card.settings()
    found = evaluate_pick(settings, 8, SHIPPED, seed=4_000_000_000)
    assert found.success.sum() >= 7, found.by_object()


def test_a_training_without_a_package_says_which_and_touches_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from allegro_twin.pick.training import train_pick

    monkeypatch.setitem(sys.modules, "onnx", None)
    monkeypatch.setitem(sys.modules, "torch", type(sys)("torch"))
    with pytest.raises(ConfigError, match=r"training needs onnx: pip install 'allegro-twin\[rl\]'"):
        train_pick(recipe(), tmp_path / "out")
    assert not (tmp_path / "out").exists()
