"""What is installed: the wheel holds the license, the marker of types and the data; help and completion are there."""

from __future__ import annotations

import subprocess
import sys
import tomllib
import zipfile
from email import message_from_string
from pathlib import Path

import pytest

import allegro_twin

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return zipfile.ZipFile(next(folder.glob("*.whl")))


def test_the_wheel_has_the_license_the_types_and_the_data(wheel: zipfile.ZipFile) -> None:
    names = set(wheel.namelist())
    assert {"allegro_twin/py.typed", "allegro_twin/_data/conf/sim_right.yaml"} <= names
    (license_file,) = (name for name in names if name.endswith(".dist-info/licenses/LICENSE"))
    assert wheel.read(license_file) == (ROOT / "LICENSE").read_bytes()
    assert b"Apache License" in wheel.read(license_file)


def test_the_wheel_says_who_made_it_and_under_which_license(wheel: zipfile.ZipFile) -> None:
    (name,) = (name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
    said = message_from_string(wheel.read(name).decode())
    assert said["License-Expression"] == PROJECT["license"] == "Apache-2.0"
    assert said["Author"] == "The allegro_twin authors"
    assert "Typing :: Typed" in said.get_all("Classifier", [])


def test_one_version_is_told_everywhere() -> None:
    assert PROJECT["version"] == allegro_twin.__version__
    assert f"version: {allegro_twin.__version__}\n" in (ROOT / "CITATION.cff").read_text()


def test_the_script_is_the_one_that_is_quiet_about_ctrl_c() -> None:
    assert PROJECT["scripts"]["allegro-twin"] == "allegro_twin.__main__:main"


@pytest.mark.parametrize("arguments", [["--version"], ["-h"], ["run", "-h"], ["calibrate", "limits", "-h"]])
def test_version_and_help_are_answered_in_every_place(arguments: list[str]) -> None:
    done = subprocess.run([sys.executable, "-m", "allegro_twin", *arguments], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert (f"allegro-twin {allegro_twin.__version__}\n" == done.stdout) == (arguments == ["--version"])


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("posture f", {"fist"}),
        ("grasp quad", {"quadpod", "quadpod_pear"}),
        ("run lem", {"lemon"}),
        ("run sim_", {"sim_left", "sim_right"}),
        ("run lemon --object gol", {"golf_ball"}),
        ("run sim_right --policy re", {"reach_right"}),
        ("posture home -c can_v", {"can_v4_right", "can_virtual"}),
        ("list pol", {"policies"}),
        ("train Reo", {"Reorient"}),
        ("play rip", {"ripple"}),
    ],
)
def test_the_shell_completes_names(typed: str, expected: set[str], monkeypatch: pytest.MonkeyPatch) -> None:
    words = f"allegro-twin {typed}"
    monkeypatch.setenv("_ALLEGRO_TWIN_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    done = subprocess.run([sys.executable, "-m", "allegro_twin"], capture_output=True, text=True)
    assert set(done.stdout.split()) == expected


def test_completion_is_shown_and_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))  # Typer asks which shell it runs in, so there must be one.
    ours = f"{sys.executable} -m allegro_twin"
    script = f"{ours} --show-completion && {ours} --install-completion; exit $?"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert "_ALLEGRO_TWIN_COMPLETE" in done.stdout
    assert any("_ALLEGRO_TWIN_COMPLETE" in path.read_text() for path in tmp_path.rglob("*") if path.is_file())
