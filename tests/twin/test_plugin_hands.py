"""A hand of an installed package is excited and mirrored as one on a bus, where it says what its torques are."""

from __future__ import annotations

import threading
from pathlib import Path

import can
import numpy as np
import pytest

from allegro_twin.app.config import load_config
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.recording.reader import load
from allegro_twin.surfaces.hand import Hand
from allegro_twin.twin.identify.motions.motion import read_motion, recorded_calibration
from tests.surfaces.cli.conftest import Run
from tests.surfaces.cli.conftest import command as command
from tests.twin import plugin_hand


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    plugin_hand.install(monkeypatch)
    path = tmp_path / "theirs.yaml"
    path.write_text("backend: {kind: theirs}\ncontroller: {kind: pd}\nseconds: 2.0\ntask: {posture: home}\n")
    return path


def without_calibration(config: Path) -> None:
    config.write_text(config.read_text().replace("kind: theirs", "kind: theirs, counts: false"))


@pytest.mark.slow
def test_a_hand_of_a_package_is_excited_and_its_gap_measured(config: Path, tmp_path: Path, command: Run) -> None:
    config.write_text(config.read_text().replace("kind: theirs", "kind: theirs, imu: false"))
    code, _, errors = command("excite", config, "--pose", "up", "--seconds", 4, "--yes", "-o", tmp_path / "ex")
    assert code == 0, errors
    recording = load(tmp_path / "ex" / "up_1.arrow")
    np.testing.assert_array_equal(recording.columns["gravity"][[0, -1]], [[0.0, 0.0, -9.81]] * 2)  # That of the pose.
    assert read_motion(recording.path).torque_constant.tolist() == [1.0] * 16
    code, shown, errors = command("gap", recording.path)
    assert code == 0, errors
    assert "open loop" in shown


def test_a_hand_of_a_package_is_mirrored(config: Path, tmp_path: Path, command: Run) -> None:
    code, shown, errors = command("mirror", config, "--record", tmp_path / "m.arrow")
    assert (code, "Nothing touched it." in shown) == (0, True), errors
    assert np.isfinite(load(tmp_path / "m.arrow").columns["disturbance"][1:]).all()
    code, again, errors = command("mirror", tmp_path / "m.arrow")
    assert (code, "Nothing touched it." in again) == (0, True), errors
    with Hand.open(load_config(config)) as hand:
        assert hand.mirror.contacts == ()


def test_the_bus_of_a_hand_of_a_package_is_logged_where_it_has_one(config: Path, tmp_path: Path, command: Run) -> None:
    code, _, errors = command("run", config, "--wire-log", tmp_path / "x.log")
    assert (code, "only a hand on a CAN bus has frames to log, and a theirs hand has none" in errors) == (2, True)
    assert not (tmp_path / "x.log").exists()
    config.write_text(config.read_text().replace("kind: theirs", "kind: theirs, frames: true"))
    code, _, errors = command("run", config, "--wire-log", tmp_path / "x.log", "--record", tmp_path / "x.arrow")
    assert code == 0, errors
    with can.LogReader(tmp_path / "x.log") as frames:
        ticks = [frame.data[0] for frame in frames]
    assert ticks == [tick % 256 for tick in range(1, len(load(tmp_path / "x.arrow")))]


def test_a_hand_that_does_not_say_what_its_torques_are_is_told_what_is_missing(
    config: Path, tmp_path: Path, command: Run
) -> None:
    without_calibration(config)
    for words in (("excite", config, "--pose", "up", "--yes", "-o", tmp_path / "ex"), ("mirror", config)):
        code, _, errors = command(*words)
        assert (code, errors.rstrip().splitlines()[-1]) == (
            2,
            "allegro-twin: allegro_right does not say what its torques are: give its backend a `calibration` "
            "(docs/contract.md#calibration)",
        )
    assert command("run", config, "--record", tmp_path / "r.arrow")[0] == 0
    for name in ("identify", "gap", "mirror"):
        code, _, errors = command(name, tmp_path / "r.arrow")
        assert (code, "give its backend a `calibration` (docs/contract.md#calibration)" in errors) == (2, True)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"torque_constant": [1.0] * 16}, "version must be one of v1, v2, v3, v4, v5, v5plus, not None"),
        ({"version": "v4"}, "torque_constant is missing: N·m at full PWM"),
        ({"version": "v4", "torque_constant": [1.0] * 15}, "torque_constant needs 16 values, one a joint; it has 15"),
        ({"version": "v4", "torque_constants": [1.0] * 16}, "no key named 'torque_constants'; did you mean"),
    ],
)
def test_a_calibration_of_another_format_is_refused_by_the_key(table: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=f"calibration: .*{said}"):
        recorded_calibration(table)


@pytest.mark.parametrize("background", [False, True])
def test_a_package_whose_close_raises_is_told_once_by_whoever_closes_the_hand(
    background: bool, config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(self: object) -> None:
        raise OSError("no such port")

    printed: list[object] = []
    monkeypatch.setattr(threading, "excepthook", printed.append)
    hand = Hand.open(load_config(config), background=background)
    hand.wait(0.05)
    monkeypatch.setattr(plugin_hand.TheirHand, "close", lost)
    with pytest.raises(HandFault, match=r"backend theirs: TheirHand\.close raises OSError: no such port \("):
        hand.close()
    assert printed == []
