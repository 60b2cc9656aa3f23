"""A recorded simulation goes on as it did, to the last bit, or otherwise from the instant of a change."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.build.assemble import assemble
from allegro_twin.build.branching import branch, changes_of
from allegro_twin.config import RunConfig, load_config
from allegro_twin.errors import ConfigError
from allegro_twin.loop import run, until
from allegro_twin.replay.recorder import recorded
from allegro_twin.replay.recording import load
from allegro_twin.session import Outputs, perform


def made(tmp_path: Path, config: RunConfig) -> Path:
    path = tmp_path / "run.arrow"
    perform(assemble(config), config, Outputs(record=path))
    return path


@pytest.mark.parametrize("name", ["sim_right", "can_virtual", "sim_left"])
def test_without_a_change_the_future_is_the_recorded_one_bit_for_bit(tmp_path: Path, name: str) -> None:
    path = made(tmp_path, load_config(name).changed(seconds=1.0))
    found = branch(path, 0.3, {})
    np.testing.assert_array_equal(found.branched, load(path).columns["position"])


def test_a_grasp_without_a_change_is_the_recorded_one_bit_for_bit(tmp_path: Path) -> None:
    content = {
        "backend": {"kind": "sim"}, "task": {"scenario": "lemon"}, "controller": {"kind": "pd"},
    }  # fmt: skip
    path = made(tmp_path, RunConfig.model_validate(content))
    same, slippery = branch(path, 6.0, {}), branch(path, 6.0, {"friction": 0.01})
    np.testing.assert_array_equal(same.branched, same.recorded)
    assert same.report is not None
    assert same.report.held
    off = np.abs(slippery.branched - slippery.recorded).max(axis=1)
    assert not off[slippery.t <= 6.0].any()
    assert slippery.report is not None
    assert not slippery.report.held


@pytest.mark.parametrize("change", [{"controller.gains": "v4"}, {"damping": 0.3}, {"frictionloss": 0.1}])
def test_a_change_acts_from_its_instant_on(tmp_path: Path, change: dict[str, object]) -> None:
    path = made(tmp_path, load_config("sim_right").changed(seconds=1.0, task={"posture": "rock"}))
    found = branch(path, 0.3, change)
    off = np.abs(found.branched - found.recorded).max(axis=1)
    assert not off[found.t <= 0.3].any()
    assert off[-1] > 1e-5


def test_what_cannot_be_repeated_says_why(tmp_path: Path, recording_path: Path) -> None:
    with pytest.raises(ConfigError, match="is of a hand, not of a simulation"):
        branch(recording_path, 0.1, {})
    path = made(tmp_path, load_config("sim_right").changed(seconds=0.3))
    with pytest.raises(ConfigError, match="--at 9 s: .* goes from 0 to 0.3 s"):
        branch(path, 9.0, {})
    for key, value, said in (
        ("engine", "mujoco 3.1.0", "was made with mujoco 3.1.0, and this is mujoco"),
        ("config", {**load(path).meta["config"], "task": {"posture": "rock"}}, "is not repeated by this program"),
    ):
        other = tmp_path / f"{key}.arrow"
        meta = {**load(path).meta, key: value}
        config = load_config("sim_right").changed(seconds=0.3)
        with closing(assemble(config).backend) as backend:
            samples = until(0.3, run(backend, assemble(config).controller))
            for _ in recorded(samples, other, backend.spec, 0.003, meta=json.loads(json.dumps(meta))):
                pass
        with pytest.raises(ConfigError, match=said):
            branch(other, 0.2, {})


def test_a_change_is_read_from_text_and_an_unknown_one_named() -> None:
    assert changes_of(["friction=0.5", "controller.gains=v4"]) == {"friction": 0.5, "controller.gains": "v4"}
    for wrong, said in (
        ("friction", "say key=value"),
        ("fricton=1", "no key named 'fricton'; did you mean 'friction'"),
        ("damping=much", "damping needs a number, not much"),
    ):
        with pytest.raises(ConfigError, match=said):
            changes_of([wrong])
