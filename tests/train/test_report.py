"""What a policy is worth is measured in the environment's own episodes, the same for every policy."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.cli import console
from allegro_twin.cli.main import main
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.gym.env import HandEnv
from allegro_twin.gym.settings import EnvSettings
from allegro_twin.policy.controller import Still
from allegro_twin.train.evaluation import Evaluation, evaluate
from allegro_twin.train.report import SEED, Compared, as_shipped, compare, filmed, sets, write
from allegro_twin.train.settings import Recipe, load_recipe

REACH = data_root() / "conf" / "policies" / "reach_right.onnx"


def recipe(**changes: Any) -> Recipe:
    return load_recipe("Reach").model_copy(update=changes)


def test_an_evaluation_is_the_single_environments_episodes_to_their_end() -> None:
    few = EnvSettings(objects=("tennis_ball", "golf_ball"), position_noise=0.03)
    found = evaluate(Still(16), "Grasp", few, 6, seed=40)
    env = HandEnv("Grasp", objects=few.objects, position_noise=0.03)
    for row in range(6):
        _, report = env.reset(seed=40 + row)
        info: dict[str, Any] = {}
        total, over = 0.0, False
        while not over:
            _, reward, failed, cut, info = env.step(np.zeros(16, np.float32))
            total, over = total + reward, failed or cut
        assert found.returned[row] == pytest.approx(total, rel=1e-12)
        assert found.success[row] == info["is_success"]
        assert found.things[row] == report["object"]
    assert 0 < found.success.sum() < 6, "all alike: nothing was told apart"
    by_thing = found.by_thing()
    assert sum(count for _, count in by_thing.values()) == 6
    assert sum(held for held, _ in by_thing.values()) == found.success.sum()
    with pytest.raises(ConfigError, match="at least 1 episode, not 0"):
        evaluate(Still(16), "Grasp", few, 0)


def test_policies_are_judged_in_what_ships_whatever_they_were_trained_in() -> None:
    grasp = load_recipe("Grasp")
    seen, unseen = sets(grasp).values()
    assert seen.timestep == EnvSettings().timestep < grasp.environment.timestep
    assert seen.randomise == EnvSettings().randomise != grasp.environment.randomise
    assert (seen.position_noise, seen.decimation) == (0.015, grasp.environment.decimation)
    assert unseen.objects == grasp.held_out
    assert as_shipped(unseen) == unseen
    rotate = load_recipe("rotate").environment
    assert rotate.device == "warp"
    assert as_shipped(rotate) == EnvSettings(decimation=rotate.decimation, state=True)
    assert list(sets(recipe())) == ["trained on"]


def test_the_shipped_policy_for_reach_beats_a_hand_that_stays(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")
    (found,) = compare(REACH, recipe(), 20)
    assert found.policy.rate > 0.8 > found.still.rate
    write([found], tmp_path / "evaluation.json")
    content = json.loads((tmp_path / "evaluation.json").read_text())
    assert content["trained on"]["policy"]["rate"] == found.policy.rate
    with pytest.raises(ConfigError, match="the policy has task AllegroTwin/Reach-v0, these environments have"):
        compare(REACH, load_recipe("Lift"), 1)


@pytest.mark.long
def test_a_film_shows_whole_episodes(tmp_path: Path) -> None:
    av = pytest.importorskip("av", reason="films are made by PyAV: extra view")
    slow = EnvSettings(decimation=40)  # A third of the pictures of a shipped policy, which take the time.
    filmed(Still(16), recipe(environment=slow), tmp_path / "policy.mp4", episodes=2)
    with av.open(str(tmp_path / "policy.mp4")) as film:
        assert sum(1 for _ in film.decode(video=0)) == 2 * HandEnv("Reach", decimation=40).engine.limit
        assert film.streams.video[0].average_rate == 8


@pytest.mark.long
def test_the_command_line_says_both_rates_and_films(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")
    asked = ["--episodes", "4", "--can", "2", "--film", str(tmp_path / "reach.mp4")]
    monkeypatch.setattr("sys.argv", ["allegro-twin", "evaluate", "reach_right", "Reach", *asked])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    said = capfd.readouterr().out
    assert "trained on" in said
    assert "0% (0% to 49%)" in said
    assert "over CAN, trained on: 100% (34% to 100%)" in said
    assert (tmp_path / "reach.mp4").stat().st_size > 10_000
    assert SEED > 1_000_000_000


def test_a_rate_is_told_with_where_it_lies_for_few_episodes_say_little() -> None:
    def found(*success: bool) -> Evaluation:
        return Evaluation(np.array(success), np.zeros(len(success)), ())

    rows = console.compared(
        [Compared("seen", found(True, True, True, True), found(False, False, True, True))], recipe()
    )
    assert [next(iter(column.cells)) for column in rows.columns] == [
        "seen",
        "4",
        "100% (51% to 100%)",
        "50% (15% to 85%)",
    ]
