"""The commands for a hand that is open do what they say, on a terminal and in a pipe."""

from __future__ import annotations

import os
import pty
import select
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest
import yaml

from allegro_twin.cli.keys import KEYS, pressed
from allegro_twin.config import load_config
from allegro_twin.description.hands import load_spec
from allegro_twin.hand import Hand
from allegro_twin.library.library import Library
from tests.cli.test_main import SUITE, allegro_twin


def test_a_posture_and_a_grasp_show_their_outcome() -> None:
    done = allegro_twin("posture", "home", "--config", "sim_left")
    assert done.returncode == 0, done.stderr
    assert "allegro_left at" in done.stdout
    done = allegro_twin("grasp", "grasp_3", "--force", "2.5")
    assert done.returncode == 0, done.stderr
    assert "what the joints felt" in " ".join(done.stdout.split())


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
def test_what_cannot_be_is_one_line_and_exit_code_2(arguments: list[str], message: str) -> None:
    done = allegro_twin(*arguments)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert message in done.stderr


def test_a_taught_posture_is_stored_for_both_hands(tmp_path: Path) -> None:
    target = tmp_path / "taught.yaml"
    done = allegro_twin("teach", "mine", "--seconds", "0.3", "--into", target, cwd=SUITE)
    assert done.returncode == 0, done.stderr
    library = Library(target)
    right, left = (library.posture("mine", load_spec(side=side)) for side in ("right", "left"))
    assert (right[4:8] == left[4:8] * (-1, 1, 1, 1)).all()


def test_calibration_writes_the_hands_own_file_and_the_hand_uses_it(tmp_path: Path) -> None:
    target = tmp_path / "mine.yaml"
    target.write_text("# my hand, bought 2019\nactuation:\n  damping: 0.08  # measured\n")
    done = allegro_twin("calibrate", "limits", "--into", target)
    assert done.returncode == 0, done.stderr
    text = target.read_text()
    assert text.startswith("# my hand, bought 2019\nactuation:\n  damping: 0.08  # measured\n")
    spec = load_spec(serial=str(target))
    assert abs(spec.lower - load_spec().lower).max() < 0.01
    assert spec.actuation.damping[0] == 0.08
    config = tmp_path / "c.yaml"
    config.write_text(
        f"hand: {{serial: {target}}}\nbackend: {{kind: sim}}\ncontroller: {{kind: pd}}\nlimits: {{margin: 0.05}}\n"
    )
    shown = allegro_twin("hand", "show", "--config", config)
    assert shown.returncode == 0, shown.stderr
    assert "margin 0.05 rad" in " ".join(shown.stdout.split())
    table = yaml.safe_load(text)
    table["limits"]["lower"] = table["limits"]["lower"][:15]
    target.write_text(yaml.safe_dump(table))
    again = allegro_twin("hand", "show", "--config", config)
    assert again.returncode == 2
    assert "limits.lower needs 16 numbers, rad" in again.stderr


def test_every_key_of_the_manufacturer_does_what_it_did() -> None:
    assert set("hrgkpmeao123") == set(KEYS)
    with Hand.open(load_config("sim_right")) as hand:
        for key in "hrgkpmeao123":
            assert pressed(hand, key) == KEYS[key].does
            hand.wait(0.3)
        assert pressed(hand, "q") is None
        assert "r ready" in str(pressed(hand, "?"))
        assert pressed(hand, "x") == "'x' has no meaning; ? lists the keys"


def test_the_keyboard_reads_keys_from_a_pipe() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "allegro_twin", "keyboard"],
        input="h o q",
        capture_output=True,
        text=True,
        cwd=SUITE,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("home") == 2
    assert "off" in done.stdout.splitlines()[-1]


def test_the_keyboard_reads_single_keys_from_a_terminal_and_leaves_it_as_it_was() -> None:
    main, other = pty.openpty()
    before = termios.tcgetattr(other)
    process = subprocess.Popen([sys.executable, "-m", "allegro_twin", "keyboard"], stdin=other, stdout=other, cwd=SUITE)
    seen = b""
    for key in (b"h", b"a", b"q"):
        seen += _until(main, b"s  " if key != b"h" else b"quit")
        os.write(main, key)
    assert process.wait(timeout=30) == 0
    assert b"home" in seen
    assert termios.tcgetattr(other) == before
    os.close(other)
    os.close(main)


def _until(terminal: int, word: bytes) -> bytes:
    seen, end = b"", time.monotonic() + 30
    while word not in seen and time.monotonic() < end:
        if select.select([terminal], [], [], 1.0)[0]:
            seen += os.read(terminal, 4096)
    assert word in seen, seen
    return seen
