"""Policy files: what they carry, what they refuse, and that both kinds answer alike for one hand and for many."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import CommandError, ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.policy.card import PolicyCard, read_card, write_card
from allegro_twin.learning.policy.loading import load_policy, policy_controller
from tests.learning.policy import tiny_onnx


@pytest.fixture(scope="module")
def card() -> PolicyCard:
    return HandEnv("Lift", objects=("lemon",)).engine.task.card()


@pytest.fixture
def onnx_file(tmp_path: Path) -> Path:
    """action = tanh(W observation), as an ONNX file without a card."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    weights = np.random.default_rng(0).normal(size=(65, 16)).astype(np.float32)
    helper, floats = onnx.helper, onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["observation", "w"], ["y"]), helper.make_node("Tanh", ["y"], ["action"])],
        "policy",
        [helper.make_tensor_value_info("observation", floats, ["batch", 65])],
        [helper.make_tensor_value_info("action", floats, ["batch", 16])],
        [onnx.numpy_helper.from_array(weights, "w")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    path = tmp_path / "policy.onnx"
    onnx.save(model, str(path))
    return path


def test_an_onnx_policy_answers_for_one_hand_and_for_many(onnx_file: Path, card: PolicyCard) -> None:
    write_card(onnx_file, card)
    loaded = load_policy(onnx_file)
    assert loaded.card == card
    many = np.random.default_rng(1).normal(size=(3, 65)).astype(np.float32)
    answers = loaded.policy(many)
    assert answers.shape == (3, 16)
    np.testing.assert_allclose(loaded.policy(many[1]), answers[1], rtol=1e-5)
    assert policy_controller(onnx_file, load_spec(), grasp="tripod_lemon").script == 0


def test_an_observation_that_a_policy_cannot_take_is_named(onnx_file: Path, card: PolicyCard) -> None:
    write_card(onnx_file, card)
    policy = load_policy(onnx_file).policy
    double: Any = np.ones(65)
    np.testing.assert_array_equal(policy(double), policy(np.ones(65, np.float32)))
    odd = np.ones((2, 65), np.float32)
    odd[1, 7] = np.nan
    other: Any = {"joints": np.ones(65)}
    for observation, words in [
        (np.zeros(5), r"policy policy\.onnx takes 65 numbers of observation, not an array of shape \(5,\)"),
        (np.zeros((2, 2, 65)), r"takes 65 numbers of observation, not an array of shape \(2, 2, 65\)"),
        (odd, "policy policy.onnx: observation is not finite: nan at 7"),
        (other, "policy policy.onnx takes observation; the observation has joints"),
    ]:
        with pytest.raises(CommandError, match=words):
            policy(observation)


def test_an_action_that_is_not_finite_names_its_policy(onnx_file: Path, card: PolicyCard) -> None:
    onnx = pytest.importorskip("onnx")
    model = onnx.load(str(onnx_file))
    model.graph.initializer[0].CopyFrom(onnx.numpy_helper.from_array(np.full((65, 16), np.nan, np.float32), "w"))
    onnx.save(model, str(onnx_file))
    write_card(onnx_file, card)
    with pytest.raises(CommandError, match=r"policy policy\.onnx: its action is not finite: nan at 0"):
        load_policy(onnx_file).policy(np.ones((2, 65), np.float32))


SEES, ROWS = 65, "batch"
NETWORKS: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    ({}, {"kind": tiny_onnx.DOUBLE}, "observation is a tensor.double. of shape .*; a policy takes and gives float32"),
    ({}, {"inputs": {"x": (ROWS, SEES)}}, "the network takes x; its inputs must be named as the parts of an"),
    ({}, {"inputs": {"observation": (ROWS, SEES), "joints": (ROWS, 3)}}, "the network takes observation, joints; its"),
    ({"observation": 10}, {"inputs": {"observation": (ROWS, 10)}},
     "its card says 10 numbers of observation and 16 of action; with history 1 and 0 privileged .* has 65 and 16"),
    ({"action": 12}, {"outputs": 12}, "its card says 65 numbers of observation and 12 of action"),
    ({"history": 7}, {}, "with history 7 and 0 privileged numbers a policy of allegro has 455 and 16"),
    ({"version": 99}, {}, r"policy\.onnx is of version 99; this package runs 1: train it anew"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "network", "message"), NETWORKS)
def test_a_policy_that_fits_no_task_of_its_hand_is_refused_when_it_is_loaded(
    tmp_path: Path, card: PolicyCard, change: dict[str, Any], network: dict[str, Any], message: str
) -> None:
    pytest.importorskip("onnxruntime")
    usual: dict[str, Any] = {"inputs": {"observation": (ROWS, SEES)}, "outputs": 16}
    text = card.model_copy(update=change).model_dump_json()
    path = tiny_onnx.write_linear(tmp_path / "policy.onnx", text, **usual | network)
    with pytest.raises(ConfigError, match=message):
        load_policy(path)
    fits = tiny_onnx.write_linear(tmp_path / "policy.onnx", card.model_dump_json(), **usual)
    assert load_policy(fits).policy(np.zeros(SEES, np.float32)).shape == (16,)


def test_a_card_that_is_no_json_is_named_with_its_file(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    inputs: dict[str, tuple[int | str, ...]] = {"observation": (ROWS, SEES)}
    path = tiny_onnx.write_linear(tmp_path / "policy.onnx", '{"task": "AllegroTwin/Li', inputs, 16)
    with zipfile.ZipFile(tmp_path / "policy.zip", "w") as archive:
        archive.writestr("allegro_twin.json", b"\xff\xfe\xfd")
    for file in (path, tmp_path / "policy.zip"):
        with pytest.raises(ConfigError, match=rf"{file.name}: its card is not JSON \(.*\): write it with write_card"):
            read_card(file)


def test_a_network_for_one_observation_at_once_says_so(tmp_path: Path, card: PolicyCard) -> None:
    pytest.importorskip("onnxruntime")
    text = card.model_dump_json()
    path = tiny_onnx.write_linear(tmp_path / "policy.onnx", text, {"observation": (1, SEES)}, 16)
    policy = load_policy(path).policy
    assert policy(np.zeros(SEES, np.float32)).shape == (16,)
    with pytest.raises(CommandError, match="takes 1 observations at once, not 3: export it with a free first axis"):
        policy(np.zeros((3, SEES), np.float32))


WRONG_SIZES = pytest.mark.parametrize(
    ("name", "size", "message"),
    [
        ("observation", 64, "the network sees 65 numbers; its card says 64, for AllegroTwin/Lift-v0"),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in (
                ("observation", 66, "the network sees 65 numbers; its card says 66, for AllegroTwin/Lift-v0"),
                ("action", 15, "the network gives 16 numbers; its card says 15, for AllegroTwin/Lift-v0"),
            )
        ),
        ("action", 17, "the network gives 16 numbers; its card says 17, for AllegroTwin/Lift-v0"),
    ],
)
"""More and fewer, of what goes in and of what comes out."""


@WRONG_SIZES
def test_a_network_that_is_not_its_cards_is_refused_with_both_sizes(
    onnx_file: Path, card: PolicyCard, name: str, size: int, message: str
) -> None:
    write_card(onnx_file, card.model_copy(update={name: size}))
    with pytest.raises(ConfigError, match=message):
        load_policy(onnx_file)


@WRONG_SIZES
def test_a_model_of_stable_baselines3_that_is_not_its_cards_is_refused_likewise(
    tmp_path: Path, card: PolicyCard, name: str, size: int, message: str
) -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    path = tmp_path / "policy.zip"
    sb3.PPO("MlpPolicy", HandEnv("Lift", objects=("lemon",)), n_steps=16, batch_size=16, device="cpu").save(path)
    write_card(path, card.model_copy(update={name: size}))
    with pytest.raises(ConfigError, match=message):
        load_policy(path, trust=True)


def test_a_network_that_takes_any_number_is_not_held_to_its_cards(onnx_file: Path, card: PolicyCard) -> None:
    """Its axis has a name instead of a number: there is nothing that could differ."""
    onnx = pytest.importorskip("onnx")
    model = onnx.load(str(onnx_file))
    for value in (model.graph.input[0], model.graph.output[0]):
        value.type.tensor_type.shape.dim[1].dim_param = "any"
    onnx.save(model, str(onnx_file))
    write_card(onnx_file, card)
    assert load_policy(onnx_file).policy(np.zeros(65, np.float32)).shape == (16,)


def test_an_onnx_file_without_a_card_is_no_policy_of_ours(onnx_file: Path) -> None:
    with pytest.raises(ConfigError, match="no card inside"):
        load_policy(onnx_file)


def test_a_policy_for_the_other_hand_is_refused(onnx_file: Path, card: PolicyCard) -> None:
    write_card(onnx_file, card)
    with pytest.raises(ConfigError, match="this policy is for the right hand; this one is the left hand"):
        policy_controller(onnx_file, load_spec(side="left"))


def test_a_model_of_stable_baselines3_is_a_policy_once_it_has_a_card(tmp_path: Path, card: PolicyCard) -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    path = tmp_path / "policy.zip"
    model: Any = sb3.PPO("MlpPolicy", HandEnv("Lift", objects=("lemon",)), n_steps=16, batch_size=16, device="cpu")
    model.save(path)
    with pytest.raises(ConfigError, match="no card inside"):
        load_policy(path)
    write_card(path, card)
    with pytest.raises(ConfigError, match="can run any program when it is loaded: take the policy's .onnx"):
        load_policy(path)
    loaded = load_policy(path, trust=True)
    seen = np.random.default_rng(1).normal(size=65).astype(np.float32)
    np.testing.assert_array_equal(loaded.policy(seen), model.predict(seen, deterministic=True)[0])
    assert loaded.card == card


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("policy.pt", b"", "a policy file ends in .onnx or .zip"),
        ("policy.zip", b"nonsense", "not a zip file"),
        ("missing.zip", None, "no such policy file"),
    ],
)
def test_a_file_that_is_no_policy_is_named(tmp_path: Path, name: str, content: bytes | None, message: str) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=message):
        load_policy(path)


def test_a_missing_library_is_an_error_that_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, card: PolicyCard
) -> None:
    path = tmp_path / "policy.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", "{}")
    write_card(path, card)
    assert read_card(path) == card
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ConfigError, match=r"needs stable-baselines3: pip install 'allegro-twin\[rl\]'"):
        load_policy(path, trust=True)
    other = tmp_path / "policy.onnx"
    other.write_bytes(b"x")
    with pytest.raises(ConfigError, match=r"needs onnxruntime: pip install 'allegro-twin\[policy\]'"):
        load_policy(other)
