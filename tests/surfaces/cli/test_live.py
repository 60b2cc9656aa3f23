"""The commands for a hand that is open do what they say, on a terminal and in a pipe."""

from __future__ import annotations

import os
import pty
import select
import subprocess
import sys
import termios
from pathlib import Path

import pytest
import yaml

from allegro_twin.app.config import load_config
from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import Library
from allegro_twin.surfaces.cli.start.keys import KEYS, press
from allegro_twin.surfaces.hand import Hand
from tests.patience import wait_for
from tests.surfaces.cli.conftest import Run

SUITE = Path(__file__).resolve().parents[3]


def test_a_posture_and_a_grasp_show_their_outcome(command: Run) -> None:
    code, shown, errors = command("posture", "home", "--config", "sim_left")
    assert code == 0, errors
    assert "allegro_left at" in shown
    code, shown, errors = command("grasp", "grasp_3", "--force", "2.5")
    assert code == 0, errors
    assert "what the joints felt" in " ".join(shown.split())


def test_a_grasp_of_an_object_that_is_not_there_is_exit_code_5(command: Run) -> None:
    code, shown, _ = command("grasp", "grasp_3", "--width", "0.05")
    assert code == 5
    assert " ".join(shown.split()).endswith("touch each other; nothing as wide as the object is there")
    assert command("grasp", "grasp_3")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["posture", "hom"], "no posture named 'hom'; did you mean 'home'"),
        (["play", "rippel"], "no trajectory named 'rippel'; did you mean 'ripple'"),
        (["grasp", "quadpod", "--width", "0.5"], "an object of 500 mm needs another grasp"),
        (["grasp", "quadpod", "--force", "2"], "grasp quadpod controls position and takes no force"),
        (["grasp", "grasp_3", "--force", "-1"], "force must be positive, not -1.0"),
        (["calibrate", "limits", "--by-hand", "0"], "--by-hand must be positive and finite, not 0.0"),
    ],
)
def test_what_cannot_be_is_one_line_and_exit_code_2(arguments: list[str], message: str, command: Run) -> None:
    code, _, errors = command(*arguments)
    assert (code, errors.count("\n")) == (2, 1)
    assert message in errors


def test_a_taught_posture_is_stored_for_both_hands(tmp_path: Path, command: Run) -> None:
    target = tmp_path / "taught.yaml"
    code, _, errors = command("teach", "mine", "--seconds", "0.3", "--into", target)
    assert code == 0, errors
    library = Library(target)
    right, left = (library.posture("mine", load_spec(side=side)) for side in ("right", "left"))
    assert (right[4:8] == left[4:8] * (-1, 1, 1, 1)).all()


def test_what_was_taught_is_replaced_only_when_that_is_said(tmp_path: Path, command: Run) -> None:
    target = tmp_path / "taught.yaml"
    assert command("teach", "keep", "--motion", "--seconds", "0.3", "--into", target)[0] == 0
    before = target.read_bytes()
    code, shown, errors = command("teach", "keep", "--seconds", "0.1", "--into", target)
    assert (code, errors.count("\n")) == (2, 1)
    assert f"'keep' is a trajectory in {target} already: --force replaces it" in errors
    assert "Move the fingers" not in shown
    assert target.read_bytes() == before
    code, _, errors = command("teach", "keep", "--seconds", "0.1", "--into", target, "--force")
    assert code == 0, errors
    assert Library(target).posture("keep", load_spec()).shape == (16,)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["Rest"], "not 'Rest'"),
        (["home"], "'home' ships with the package"),
        (["new", "--into", "one.yaml"], "holds one entry, 'one'; store 'new' in another file"),
        (["mine", "--into", "other.yaml"], "library/mine.yaml already; store it there or delete it first"),
    ],
)
def test_what_cannot_be_stored_is_refused_before_it_is_shown(
    arguments: list[str], message: str, tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    posture = (data_root() / "conf" / "postures" / "rock.yaml").read_text()
    Path("library").mkdir()
    for file in ("one.yaml", "library/mine.yaml"):
        Path(file).write_text(posture)
    code, shown, errors = command("teach", *arguments, "--seconds", "0.1")
    assert (code, errors.count("\n")) == (2, 1)
    assert message in errors
    assert "Move the fingers" not in shown


@pytest.mark.slow
def test_calibration_writes_the_hands_own_file_and_the_hand_uses_it(tmp_path: Path, command: Run) -> None:
    target = tmp_path / "mine.yaml"
    target.write_text("# my hand, bought 2019\nactuation:\n  damping: 0.08  # measured\n")
    code, _, errors = command("calibrate", "limits", "--into", target)
    assert code == 0, errors
    text = target.read_text()
    assert text.startswith("# my hand, bought 2019\nactuation:\n  damping: 0.08  # measured\n")
    spec = load_spec(serial=str(target))
    assert abs(spec.lower - load_spec().lower).max() < 0.01
    assert spec.actuation.damping[0] == 0.08
    config = tmp_path / "c.yaml"
    config.write_text(
        f"hand: {{serial: {target}}}\nbackend: {{kind: sim}}\ncontroller: {{kind: pd}}\nlimits: {{margin: 0.05}}\n"
    )
    code, shown, errors = command("hand", "show", "--config", config)
    assert code == 0, errors
    assert "margin 0.05 rad" in " ".join(shown.split())
    table = yaml.safe_load(text)
    table["limits"]["lower"] = table["limits"]["lower"][:15]
    target.write_text(yaml.safe_dump(table))
    code, _, errors = command("hand", "show", "--config", config)
    assert code == 2
    assert "limits.lower needs 16 numbers, rad" in errors


@pytest.mark.parametrize(("version", "limits"), [("v4", "0.5625"), ("v5", "0.1678"), ("v5plus", "0.3357")])
def test_the_torque_limits_that_are_shown_are_those_of_the_version(
    version: str, limits: str, tmp_path: Path, command: Run
) -> None:
    config = tmp_path / "c.yaml"
    bus = f"{{kind: can, version: {version}, interface: allegro-virtual}}"
    config.write_text(f"backend: {bus}\ncontroller: {{kind: pd}}\n")
    code, shown, errors = command("hand", "show", "--config", config)
    assert code == 0, errors
    middle = next(line for line in shown.splitlines() if "middle_1" in line)
    assert limits in middle


def test_every_key_of_the_manufacturer_does_what_it_did() -> None:
    assert set("hrgkpmeao123") == set(KEYS)
    with Hand.open(load_config("sim_right")) as hand:
        for key in "hrgkpmeao123":
            assert press(hand, key) == KEYS[key].does
            hand.wait(0.3)
        assert press(hand, "q") is None
        assert "r ready" in str(press(hand, "?"))
        assert press(hand, "x") == "'x' has no meaning; ? lists the keys"


@pytest.mark.slow
def test_the_keyboard_reads_keys_from_a_pipe() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "allegro_twin", "keyboard"],
        input="h o q",
        capture_output=True,
        text=True,
        cwd=SUITE,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("home") == 2
    assert "off" in done.stdout.splitlines()[-1]


@pytest.mark.slow
def test_the_keyboard_reads_single_keys_from_a_terminal_and_leaves_it_as_it_was() -> None:
    main, other = pty.openpty()
    before = termios.tcgetattr(other)
    process = subprocess.Popen([sys.executable, "-m", "allegro_twin", "keyboard"], stdin=other, stdout=other, cwd=SUITE)
    seen = b""
    for key in (b"h", b"a", b"q"):
        seen += _until(main, b"s  " if key != b"h" else b"quit")
        os.write(main, key)
    assert process.wait() == 0
    assert b"home" in seen
    assert termios.tcgetattr(other) == before
    os.close(other)
    os.close(main)


def _until(terminal: int, word: bytes) -> bytes:
    seen = b""

    def shown() -> bool:
        nonlocal seen
        if select.select([terminal], [], [], 0.1)[0]:
            seen += os.read(terminal, 4096)
        return word in seen

    wait_for(shown, repr(word), 60.0)
    assert word in seen, seen
    return seen
