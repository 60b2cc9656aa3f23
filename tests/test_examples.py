"""Every example runs, in an empty folder, checks what it shows, and is short enough to read.

The first by a Python of its own, as a reader runs it; the others in this process, which has the libraries loaded.
"""

from __future__ import annotations

import ast
import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
NEEDS = {"train_ppo": ("stable_baselines3", "torch", "onnx", "onnxruntime", "tensorboard")}
SHORT = {"train_ppo": ("Reach", "4096")}
"""Arguments with which an example takes seconds."""


def test_there_are_twelve() -> None:
    assert len(EXAMPLES) >= 12


def performed(path: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """An example, run by a Python of its own in a folder."""
    return subprocess.run(
        [sys.executable, path, *SHORT.get(path.stem, ())],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )


def test_the_first_runs_from_an_empty_folder(tmp_path: Path) -> None:
    done = performed(EXAMPLES[0], tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


LONG = ("06_grasp_an_object", "07_your_own_object", "12_force_grasp")


def marks_of(name: str) -> tuple[pytest.MarkDecorator, ...]:
    """What trains takes a minute where it can."""
    return (pytest.mark.long,) if name in LONG else (pytest.mark.slow,) if name in NEEDS else ()


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=marks_of(path.stem), id=path.stem) for path in EXAMPLES],
)
def test_it_runs_and_says_what_it_did(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for module in NEEDS.get(path.stem, ()):
        pytest.importorskip(module, reason="the example trains: extra rl")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(path), *SHORT.get(path.stem, ())])
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out.strip()
    assert path.read_text().count("\n") <= 40


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_it_checks_what_it_shows(path: Path) -> None:
    """With an `assert` outside of functions, so that it is reached."""
    body = ast.parse(path.read_text()).body
    reached = [node for part in body if not isinstance(part, ast.FunctionDef | ast.ClassDef) for node in ast.walk(part)]
    assert any(isinstance(node, ast.Assert) for node in reached)


@pytest.mark.long
def test_an_example_that_shows_something_else_is_noticed(tmp_path: Path) -> None:
    """The ball stays on the table where the palm is not where this grasp needs it."""
    path = tmp_path / "wrong.py"
    path.write_text((ROOT / "examples" / "12_force_grasp.py").read_text().replace('io("grasp_3")', 'io("tennis_ball")'))
    done = performed(path, tmp_path)
    assert done.returncode == 1
    assert "dropped" in done.stdout
    assert done.stderr.rstrip().endswith("AssertionError")
