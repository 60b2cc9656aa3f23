"""What is installed: the wheel holds the license, the marker of types and the data; help and completion are there."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from email import message_from_string
from pathlib import Path

import pytest

import allegro_twin
from tests.surfaces.cli.conftest import Run, command

__all__ = ["command"]  # The command line in this process, as a fixture.
ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
SIMULATED = {path.stem for path in (ROOT / "conf").glob("sim_*.yaml")}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    return zipfile.ZipFile(built(tmp_path_factory.mktemp("wheel"), "wheel"))


def built(folder: Path, target: str) -> Path:
    """A `wheel` or an `sdist`, as `pip` would have it made."""
    command = [sys.executable, "-m", "hatchling", "build", "--target", target, "--directory", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return next(folder.glob("*.whl" if target == "wheel" else "*.tar.gz"))


def test_the_wheel_has_the_license_the_types_and_the_data(wheel: zipfile.ZipFile) -> None:
    names = set(wheel.namelist())
    assert {"allegro_twin/py.typed", "allegro_twin/_data/conf/sim_right.yaml"} <= names
    examples = {f"allegro_twin/_data/examples/{path.name}" for path in (ROOT / "examples").iterdir() if path.is_file()}
    assert "allegro_twin/_data/examples/hand_tracking.csv" in examples <= names
    (license_file,) = (name for name in names if name.endswith(".dist-info/licenses/LICENSE"))
    assert wheel.read(license_file) == (ROOT / "LICENSE").read_bytes()
    assert b"Apache License" in wheel.read(license_file)


def test_the_wheel_says_who_made_it_and_under_which_license(wheel: zipfile.ZipFile) -> None:
    (name,) = (name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
    said = message_from_string(wheel.read(name).decode())
    assert said["License-Expression"] == PROJECT["license"] == "Apache-2.0"
    assert said["Author"] == "The allegro_twin authors"
    assert "Typing :: Typed" in said.get_all("Classifier", [])


def test_a_wheel_that_is_built_again_is_the_same_to_the_byte(wheel: zipfile.ZipFile, tmp_path: Path) -> None:
    again = built(tmp_path, "wheel")
    assert wheel.filename is not None
    assert again.read_bytes() == Path(wheel.filename).read_bytes()


def started(version: str) -> str:
    """A Python. A manager of versions may leave a name on the path for one that is not switched on."""
    python = shutil.which(f"python{version}")
    if python is None or subprocess.run([python, "-c", ""], capture_output=True).returncode != 0:
        pytest.skip(f"no python{version} here")
    return python


TOUR = """
import gymnasium, pathlib, allegro_twin, allegro_twin.surfaces.panel.host, allegro_twin.surfaces.teleop.session
assert "site-packages" in allegro_twin.__file__, allegro_twin.__file__
env = gymnasium.make("allegro_twin.gym:AllegroTwin/Reach-v0")
env.reset(seed=0); env.step(env.action_space.sample())
"""


@pytest.mark.long
@pytest.mark.parametrize("target", ["wheel", "sdist"])
@pytest.mark.parametrize("version", ["3.11", "3.12", "3.13"])
def test_what_is_built_runs_in_an_environment_of_its_own(version: str, target: str, tmp_path: Path) -> None:
    """Outside of the checkout, with the versions that an index gives today."""
    python = started(version)
    made, own = built(tmp_path, target), tmp_path / "venv" / "bin"
    quiet = [str(own / "pip"), "install", "--quiet", "--disable-pip-version-check"]
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    for words in (
        [python, "-m", "venv", str(tmp_path / "venv")],
        [*quiet, f"{made}[view]"],
        [str(own / "allegro-twin"), "list"],
        [str(own / "allegro-twin"), "envs"],
        [str(own / "allegro-twin"), "examples", "mine"],
        [str(own / "python"), "mine/01_move_home.py"],
        [str(own / "allegro-twin"), "run", "lemon", "--out", str(tmp_path / "out")],
        [str(own / "python"), "-c", TOUR],
    ):
        done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, (words, done.stdout[-1000:], done.stderr[-2000:])
    assert (tmp_path / "out" / "lemon_right.png").is_file()


def test_one_version_is_told_everywhere() -> None:
    assert PROJECT["version"] == allegro_twin.__version__
    assert f"version: {allegro_twin.__version__}\n" in (ROOT / "CITATION.cff").read_text()


def test_the_script_is_the_one_that_is_quiet_about_ctrl_c() -> None:
    assert PROJECT["scripts"]["allegro-twin"] == "allegro_twin.__main__:main"


def test_the_package_is_a_program() -> None:
    done = subprocess.run([sys.executable, "-m", "allegro_twin", "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"allegro-twin {allegro_twin.__version__}\n", "")


@pytest.mark.parametrize("arguments", [["--version"], ["-h"], ["run", "-h"], ["calibrate", "limits", "-h"]])
def test_version_and_help_are_answered_in_every_place(arguments: list[str], command: Run) -> None:
    code, shown, errors = command(*arguments)
    assert (code, errors) == (0, "")
    assert (f"allegro-twin {allegro_twin.__version__}\n" == shown) == (arguments == ["--version"])


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("posture f", {"fist", "flat"}),
        ("grasp quad", {"quadpod", "quadpod_pear"}),
        ("run lem", {"lemon"}),
        ("run sim_", SIMULATED),
        ("run lemon --object gol", {"golf_ball"}),
        ("run sim_right --policy re", {"reach_right", "reorient_right"}),
        ("posture home -c can_v", {"can_v4_right", "can_virtual"}),
        ("list pol", {"policies"}),
        ("teleop sim_", SIMULATED),
        ("train Reo", {"Reorient"}),
        ("play rip", {"ripple"}),
    ],
)
def test_the_shell_completes_names(
    typed: str, expected: set[str], command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = f"allegro-twin {typed}"
    monkeypatch.setenv("_ALLEGRO_TWIN_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    assert set(command()[1].split()) == expected


def test_completion_is_shown_and_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))  # Typer asks which shell it runs in, so there must be one.
    ours = f"{sys.executable} -m allegro_twin"
    script = f"{ours} --show-completion && {ours} --install-completion; exit $?"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert "_ALLEGRO_TWIN_COMPLETE" in done.stdout
    assert any("_ALLEGRO_TWIN_COMPLETE" in path.read_text() for path in tmp_path.rglob("*") if path.is_file())
