"""docs/how-to/add_a_hand.md does what it says, from an empty folder, and its list of files is what the repository
has."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "how-to" / "add_a_hand.md").read_text()
FACTS = (ROOT / "docs" / "how-to" / "add_a_hand_from_facts.md").read_text()
FILE = re.compile(r"```\w+\n(?:<!-- |# )(\w+\.\w+)(?: -->)?\n(.*?)```", re.DOTALL)
COMMAND = re.compile(r"^allegro-twin (.+)$", re.MULTILINE)
SLOW = "plan "
"""Of these tests/hands/test_planning.py has one."""


def performed(folder: Path, *words: str) -> None:
    done = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.slow
def test_the_page_runs_from_an_empty_folder(tmp_path: Path) -> None:
    written = dict(FILE.findall(PAGE))
    assert list(written) == ["gripper.xml", "close.py"]
    for name, text in written.items():
        (tmp_path / name).write_text(text)
    for words in COMMAND.findall(PAGE):
        if not words.startswith(SLOW):
            performed(tmp_path, "-m", "allegro_twin", *words.split())
    performed(tmp_path, "close.py")
    assert (tmp_path / "gripper.png").stat().st_size > 10_000


def test_leaps_files_are_those_of_the_table() -> None:
    rows = re.findall(r"^\| (`.*?) \|", FACTS.split("## The files")[1].split("## ")[0], re.MULTILINE)
    told = {path for row in rows for path in re.findall(r"`([^`]+)`", row)}
    made = {"models/mjcf/leap_*.xml", "models/urdf/leap_*.urdf"}
    known = {path for pattern in told | made for path in ROOT.glob(pattern)}
    folders = ("allegro_twin", "conf", "models", "scenarios", "plugins")
    there = {
        path
        for folder in folders
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "leap" in re.split(r"[_./]", path.name) and path.suffix != ".pyc"
    }
    assert there == known
    assert all(any(ROOT.glob(pattern)) for pattern in told)
