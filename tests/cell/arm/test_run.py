"""Arms through a run's config: the shipped ones, their recordings, and what a config cannot mean."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.app import assemble
from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.app.session import Outputs, perform
from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import parse_settings
from allegro_twin.loop import run, to_the_end
from allegro_twin.recording.reader import load

IMPEDANCE = {"kind": "impedance", "position": [0.4, 0.0, 0.5]}


def config(**blocks: Any) -> RunConfig:
    whole = {"hand": {"model": "fer"}, "backend": {"kind": "sim"}, "controller": IMPEDANCE, "period": 0.001}
    return parse_settings(RunConfig, whole | blocks, "test")


@pytest.mark.parametrize("name", ["arm_fer", "arm_fr3"])
def test_a_shipped_config_brings_the_flange_to_its_pose(name: str) -> None:
    from allegro_twin.kinematics.arm import ArmModel
    from allegro_twin.spec.arm import ArmSpec

    settings = load_config(name)
    rig = assemble(settings)
    assert isinstance(rig.spec, ArmSpec)
    last = perform(rig, settings, Outputs()).last
    wanted = settings.controller.position  # type: ignore[union-attr]
    # Dry friction alone would hold the first one 2 mm away.
    np.testing.assert_allclose(ArmModel(rig.spec).pose(last.position).position, wanted, atol=4e-4)


def test_an_arms_recording_replays_through_its_config_and_shows_the_arm(tmp_path: Path) -> None:
    path, settings = tmp_path / "arm.arrow", config(seconds=0.2)
    perform(assemble(settings), settings, Outputs(record=path))
    recording = load(path)
    assert recording.columns["wrench"].shape == (201, 6)
    assert [body["name"] for body in recording.meta["look"]["hand"]][1:3] == ["fer_link1", "fer_link2"]
    rig = assemble(config(backend={"kind": "replay", "file": str(path)}))
    torques = [s.command.torque for s in to_the_end(run(rig.backend, rig.controller))]  # type: ignore[union-attr]
    assert len(torques) == 201
    np.testing.assert_array_equal(torques[50], recording.columns["command_torque"][50])


@pytest.mark.parametrize(
    ("blocks", "words"),
    [
        ({"controller": {"kind": "pd"}}, "controller.kind pd is for hands; fer is an arm: use impedance, compliance"),
        ({"hand": {"model": "allegro"}}, "controller.kind impedance is for arms; allegro_right is a hand: use pd"),
        ({"controller": IMPEDANCE | {"iterations": 3}}, "controller.iterations are the compliance's: leave them out"),
        ({"controller": IMPEDANCE | {"position": [1.4, 0, 0.3]}}, "fer does not reach .* ask for one nearer"),
        ({"task": {"scenario": "demo"}}, "task.scenario is a hand's: leave it out for an arm"),
        ({"controller": IMPEDANCE | {"positon": 1}}, "positon"),
        ({"hand": {"model": "fer", "side": "left"}}, "fer is an arm, and an arm has no side"),
    ],
)
def test_what_an_arms_config_cannot_mean_is_said_in_a_line(blocks: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        assemble(config(**blocks))


def test_a_spring_that_friction_would_hold_is_refused_before_the_arm_moves() -> None:
    settings = config(controller=IMPEDANCE | {"stiffness": 5.0})
    with pytest.raises(ConfigError, match="take at least 11.5 N/m"):
        perform(assemble(settings), settings, Outputs())


def test_a_guard_lets_an_arm_go_no_faster_than_its_maker() -> None:
    from allegro_twin.app.rig import limits_of
    from allegro_twin.hands.description.arms import load_arm_spec
    from allegro_twin.hands.settings import LimitSettings

    spec = load_arm_spec("fer")
    assert limits_of(LimitSettings(), spec).velocity.tolist() == [2.175] * 4 + [2.61] * 3
    assert limits_of(LimitSettings(velocity=1.0, torque=5.0), spec).velocity.tolist() == [1.0] * 7
    assert limits_of(LimitSettings(torque=5.0), spec).torque.tolist() == [5.0] * 7
