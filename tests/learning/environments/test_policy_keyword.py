"""`gymnasium.make(…, policy=…)` makes the environment in which a policy was trained."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import allegro_twin.gym  # noqa: F401  # It registers the ids.
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.learning import load_policy
from allegro_twin.learning.environments import engine
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.settings import EnvSettings, env_keywords
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.policy.card import check_card, read_card
from allegro_twin.learning.tasks import make_task
from allegro_twin.learning.training.settings import load_recipe
from tests.learning.policy import tiny_onnx

pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")

POLICIES = {
    "grasp_right": "grasp_easy",
    "hold_disturbed_right": "holddisturbed",
    "lift_right": "lift",
    "lift_leap": "lift_leap",
    "pinch_right": "pinch",
    "reach_right": "reach",
    "reorient_right": "reorient_on_palm",
    "rotate_cradle_right": "rotate_cradle",
    "rotate_fingertips_right": "rotate",
    "rotate_hand_right": "rotate_on_palm_hand",
    "rotate_right": "rotate_on_palm",
}
"""The recipe of each."""
CONTRADICTIONS: list[tuple[str, dict[str, Any], str]] = [
    ("Rotate", {"palm": "forbidden"}, "rotate_right was trained with palm allowed, not forbidden: leave out palm, or"),
    ("Rotate", {"decimation": 13}, "trained with decimation 20, not 13: leave out decimation"),
    ("Rotate", {"step": 0.2}, "trained with step 0.08, not 0.2: leave out step"),
    ("Rotate", {"control": "torque"}, "trained with control delta, not torque: leave out control"),
    ("Rotate", {"side": "left"}, "trained with side right, not left: leave out side"),
    ("RotateLeft", {}, "for the right hand, and this id the left hand's: take the id without a side"),
    ("Lift", {}, "is for AllegroTwin/Rotate-v0, not for AllegroTwin/Lift-v0: make that id"),
    ("Rotate", {"policy": "rotat_right"}, "did you mean 'rotate_right'"),
    ("Rotate", {"policy": "policy.txt"}, "a policy file ends in .onnx or .zip"),
]


def test_every_policy_ships_with_the_environment_of_its_recipe_and_fits_it() -> None:
    shipped = {path.stem for path in (data_root() / "conf" / "policies").glob("*.onnx")}
    assert shipped - {"arm_pick_right"} == {*POLICIES}, "that of ArmPick has a card of its own"
    for name, recipe_name in POLICIES.items():
        recipe, card = load_recipe(recipe_name), read_card(data_root() / "conf" / "policies" / f"{name}.onnx")
        settings = engine.read_keywords(recipe.task, {"policy": name})
        assert (settings.device, settings.state) == ("cpu", False)
        ours, theirs = (
            each.model_copy(update={"state": False, "device": "cpu"}).model_dump(exclude={"randomise"})
            for each in (settings, recipe.environment)
        )
        assert ours == theirs
        assert name == "rotate_right" or settings.randomise == recipe.environment.randomise
        one = settings.model_copy(update={"objects": settings.objects and settings.objects[:1]})
        check_card(card, make_task(recipe.task, one, 1, 1).card())


def test_a_policy_acts_in_its_environment_alone_and_in_a_batch() -> None:
    policy = load_policy("rotate_right").policy
    env = gymnasium.make("AllegroTwin/Rotate-v0", policy="rotate_right", objects=("rubiks_cube",))
    envs = gymnasium.make_vec("AllegroTwin/Rotate-v0", 2, policy="rotate_right")
    single, _ = env.reset(seed=4)
    batch, _ = envs.reset(seed=4)
    for _ in range(3):
        single = env.step(policy(single))[0]
        batch = envs.step(policy(batch))[0]
    np.testing.assert_allclose(batch[0], single, atol=1e-5)  # ONNX multiplies a batch in another order.
    assert env.unwrapped.engine.task.settings.palm == "allowed"  # type: ignore[attr-defined]


@pytest.mark.parametrize(("task", "keywords", "message"), CONTRADICTIONS)
def test_a_keyword_that_contradicts_the_policy_is_refused_with_both_values(
    task: str, keywords: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        gymnasium.make(f"AllegroTwin/{task}-v0", **{"policy": "rotate_right", **keywords})
    assert "\n" not in str(error.value)


def test_a_keyword_that_says_the_same_or_varies_episodes_may_stand_beside_it() -> None:
    given = {"policy": "rotate_right", "palm": "allowed", "step": 0.08, "timestep": 0.001, "randomise": "off",
             "reward": {"back": 1.0}}  # fmt: skip
    settings = engine.read_keywords("Rotate", given)
    assert (settings.palm, settings.timestep, settings.reward) == ("allowed", 0.001, {"back": 1.0})
    assert settings.randomise == EnvSettings().randomise
    assert engine.read_keywords("Rotate", {"policy": "rotate_right"}).randomise.mass == (0.8, 1.2)


def test_a_card_that_does_not_say_its_environment_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    bare = read_card(data_root() / "conf" / "policies" / "reach_right.onnx").model_copy(update={"environment": None})
    monkeypatch.setattr(engine, "read_card", lambda path: bare)
    with pytest.raises(ConfigError, match="reach_right does not say in which environments it was trained"):
        engine.read_keywords("Reach", {"policy": "reach_right"})


CARDS: list[tuple[dict[str, Any], str]] = [
    ({"version": 99}, "is of version 99; this package runs 1: train it anew"),
    ({"hand": "leap"}, "has hand leap, these environments have allegro: its card and its environment differ"),
    ({"side": "left"}, "has side left, these environments have right"),
    ({"step": 0.3}, "has step 0.3, these environments have 0.08"),
    ({"gains": "stiff"}, "has gains stiff, these environments have default"),
    ({"history": 7}, "has history 7, these environments have 10"),
    ({"decimation": 5}, "has decimation 5, these environments have 20"),
    ({"observation": 10}, "has observation 10, these environments have 640"),
]


@pytest.mark.parametrize(("change", "message"), CARDS)
def test_a_card_that_is_not_of_its_own_environment_is_refused(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    card = read_card(data_root() / "conf" / "policies" / "rotate_hand_right.onnx").model_copy(update=change)
    file = tiny_onnx.write_linear(
        tmp_path / "mine.onnx", card.model_dump_json(), {"observation": ("n", card.observation)}, 16
    )
    with pytest.raises(ConfigError, match=message) as error:
        HandEnv("Rotate", policy=str(file))
    assert "mine.onnx" in str(error.value)
    with pytest.raises(ConfigError, match=message):
        HandVectorEnv("Rotate", 2, policy=str(file))


def test_a_network_that_takes_what_its_environment_does_not_show_is_refused(tmp_path: Path) -> None:
    card = read_card(data_root() / "conf" / "policies" / "rotate_hand_right.onnx")
    inputs: dict[str, tuple[int | str, ...]] = {"observation": ("n", card.observation), "desired_goal": ("n", 4)}
    file = tiny_onnx.write_linear(tmp_path / "mine.onnx", card.model_dump_json(), inputs, 16)
    with pytest.raises(ConfigError, match="takes desired_goal; an observation of these environments has observation"):
        HandEnv("Rotate", policy=str(file))


def test_a_card_tells_its_environment_so_that_it_is_made_again() -> None:
    ours = EnvSettings(timestep=0.003, palm="allowed", objects=("cube",), randomise="default")  # type: ignore[arg-type]
    card = make_task("Rotate", ours, 1, 1).card()
    assert EnvSettings(**type(card).model_validate_json(card.model_dump_json()).environment or {}) == ours
    assert env_keywords(ours).keys() == (card.environment or {}).keys()
