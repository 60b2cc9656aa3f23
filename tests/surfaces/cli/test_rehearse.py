"""`allegro-twin rehearse`: whose hand it takes, what it asks before, and how it ends."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli.twin.rehearse import config_of, protocol_of
from allegro_twin.twin.rehearsal import HandRehearsal
from tests.surfaces.cli.conftest import Run


def test_an_interface_is_a_hand_once_its_version_is_known() -> None:
    config: Any = config_of("can0", "v5", "left")
    assert (config.backend.channel, config.backend.version, config.hand.side) == ("can0", "v5", "left")
    assert config.controller.gains == "v4"
    with pytest.raises(ConfigError, match="can0 is an interface: say the hand's --version, v1 to v5plus$"):
        config_of("can0", None, "left")
    with pytest.raises(ConfigError, match="can_virtual says its own"):
        config_of("can_virtual", "v4", "right")
    with pytest.raises(ConfigError, match="--side is for a hand on an interface .*; can_virtual says its own"):
        config_of("can_virtual", None, "left")


@pytest.mark.parametrize("words", [("rehearse",), ("compare",)])
def test_a_command_for_one_hand_lists_the_sides_that_it_takes(words: tuple[str, ...], command: Run) -> None:
    code, out, _ = command(*words, "--help")
    assert code == 0
    assert "right|left" in out
    assert "|both" not in out
    code, _, err = command(*words, "lemon", "mug", "--side", "both")
    assert code == 2
    assert "'both' is not one of 'right', 'left'" in err


def test_poses_and_grasps_are_checked_before_anything_moves() -> None:
    protocol = protocol_of("up, side", "lemon,mug", 3)
    assert (tuple(protocol.poses), protocol.grasps, protocol.seed) == (("up", "side"), ("lemon", "mug"), 3)
    assert tuple(protocol_of(None, None, 0).poses) == ("up", "side", "palm-up")
    with pytest.raises(ConfigError, match="did you mean 'side'"):
        protocol_of("sides", None, 0)
    with pytest.raises(ConfigError, match="lemom"):
        protocol_of(None, "lemom", 0)


def test_a_hand_that_a_person_must_lay_down_needs_a_terminal_or_yes(tmp_path: Path, command: Run) -> None:
    code, _, err = command("rehearse", "can0", "--version", "v4", "-o", tmp_path / "out")
    assert code == 2
    assert "run it in a terminal, or say --yes and --poses" in err


def test_the_end_says_what_was_not_reached_and_where_the_page_is(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(own: HandRehearsal) -> dict[str, Any]:
        rows = [{"controller": "pd", "error": [0.004] * 16}]
        twins = {twin: {"postures": rows, "trajectories": [], "grasps": []} for twin in own.protocol.twins}
        result: dict[str, Any] = json.loads(json.dumps(own.result()))
        return result | twins | {"hand_s": 390.0, "problems": list(problems)}

    monkeypatch.setattr(HandRehearsal, "run", run)
    problems = ["nominal palm-up ok pd: not reached: rad off: ring_2 -0.31"]
    code, out, err = command("rehearse", "can_virtual", "-o", tmp_path / "out")
    assert code == 5
    assert "6.5 min of motion" in out
    assert "postures under PD, mrad rms" in out
    assert f"Page: {tmp_path / 'out' / 'report.html'}" in out
    assert problems[0] in err
    problems.clear()
    assert command("rehearse", "can_virtual", "-o", tmp_path / "out")[0] == 0
