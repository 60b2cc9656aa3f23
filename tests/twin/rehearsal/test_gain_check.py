"""What a hand's own twin foretells of gains is what the hand does."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import yaml

from allegro_twin.app import assemble
from allegro_twin.app.config import load_config
from allegro_twin.app.session import recording_meta
from allegro_twin.loop import run, until
from allegro_twin.recording.recorder import record
from allegro_twin.surfaces.cli.twin.identification import gain_lines
from allegro_twin.twin.rehearsal.gain_check import advice_on_gains, foretell_oscillation, gain_advice

HAND = {"model": "allegro", "side": "right"}
PLAY = {"backlash": [0.005] * 16, "gear_compliance": [1.0 / 30.0] * 16, "delay": 0.003}


def own_file(folder: Path, drive: dict[str, Any]) -> str:
    path = folder / "own.yaml"
    path.write_text(yaml.safe_dump({"model": "allegro", "drive": drive}))
    return str(path)


@pytest.mark.parametrize("version", ["v3", pytest.param("v4", marks=pytest.mark.slow)])
def test_a_file_with_play_foretells_which_gains_oscillate(version: str, tmp_path: Path) -> None:
    found = foretell_oscillation(HAND, version, own_file(tmp_path, PLAY), ["default", "loose"], ["ok"])
    assert "thumb_0 ±" in found["default"]
    assert found["loose"] == ""


def test_a_file_without_play_foretells_nothing(tmp_path: Path) -> None:
    assert foretell_oscillation(HAND, "v4", own_file(tmp_path, {"delay": 0.003}), ["default"]) == {}


def test_the_advice_names_gains_that_calm_or_says_what_to_change() -> None:
    swings = "thumb_0 ±9.0 mrad at 23 Hz"
    assert gain_advice({}) == gain_advice({"default": "", "loose": swings}) == ""
    calm = gain_advice({"default": swings, "loose": ""})
    assert calm.startswith(f"Its twin foretells that with the gains `default` it oscillates ({swings})")
    assert calm.endswith("with `loose` it rests: set controller.gains.")
    assert gain_advice({"default": swings, "loose": swings}).endswith("; take gains with less damping.")


def test_gains_that_are_not_in_the_library_are_said_not_to_be_tried(tmp_path: Path) -> None:
    said = advice_on_gains(HAND, "v4", own_file(tmp_path, PLAY), "mine")
    assert said.startswith("Whether the gains `mine` let it rest could not be simulated: ")
    assert "mine" in said.partition(": ")[2]


@pytest.mark.slow
def test_identify_says_it_of_the_gains_that_a_hand_was_recorded_with(tmp_path: Path) -> None:
    config = load_config("can_virtual").changed(task={"posture": "home"}, seconds=0.3)
    recording, file = tmp_path / "motion.arrow", own_file(tmp_path, PLAY)
    rig = assemble(config)
    with closing(rig.backend):
        samples = until(0.3, run(rig.backend, rig.controller))
        for _ in record(samples, recording, rig.spec, config.period, meta=recording_meta(rig, config)):
            pass
    assert "with `loose` it rests" in gain_lines(recording, Path(file))
    assert gain_lines(recording, Path(own_file(tmp_path, {"delay": 0.003}))) == ""
