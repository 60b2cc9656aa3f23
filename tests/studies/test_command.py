"""`python -m studies.preemption` on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from rich.console import Console

from allegro_twin.surfaces.cli import console, exit_codes
from studies.preemption.__main__ import app
from tests.studies.small import content
from tests.surfaces.cli.conftest import Run


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str]) -> Run:
    """The study's command line in this process: exit code, standard output and error."""

    def run(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended, pytest.MonkeyPatch.context() as patch:
            for name in ("console", "errors"):
                patch.setattr(console, name, Console(width=160, stderr=name == "errors"))
            exit_codes.run(app, [*map(str, arguments)], "python -m studies.preemption")
        shown = capsys.readouterr()
        return int(ended.value.code or 0), shown.out, shown.err

    return run


@pytest.fixture
def protocol(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(yaml.safe_dump(content(pairs={"train": 2, "test": 2}, controls={})))
    return path


@pytest.mark.slow
def test_a_study_goes_on_where_it_stopped_and_says_what_it_found(command: Run, protocol: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    asked = ("run", "--protocol", protocol, "--out", out, "--jobs", 1)
    code, shown, _ = command(*asked, "--pairs", 0)
    assert code == 0
    assert "Nothing can be said" in shown
    code, shown, _ = command(*asked)
    assert code == 0
    assert "model_o: P" in shown
    assert "against P0e on 2 pairs" in shown
    before = (out / "trials.parquet").read_bytes()
    assert command("report", out)[0] == 0
    assert (out / "trials.parquet").read_bytes() == before
    changed = protocol.with_name("other.yaml")
    changed.write_text(yaml.safe_dump(content(seed=7)))
    code, _, error = command("run", "--protocol", changed, "--out", out, "--jobs", 1)
    assert code == 2
    assert "is of another sweep" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("run", "--hand", "sihh"), "no hand of the study named 'sihh'; did you mean 'sih'"),
        (("run", "--pairs", 5000), "--pairs 5000: the protocol has 1512 pairs of test a hand"),
        (("run", "--protocol", "premption"), "no study named 'premption'; did you mean 'preemption'"),
        (("report", "nowhere"), "nothing was swept into it"),
    ],
)
def test_a_slip_is_one_line(
    command: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[object, ...], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, error = command(*arguments)
    assert code == 2
    assert said in error
    assert error.count("\n") == 1


@pytest.mark.slow
def test_on_the_command_line_a_study_is_registered_refused_and_called_exploratory(
    command: Run, protocol: Path, tmp_path: Path
) -> None:
    assert command("register", protocol, "--when", "today")[0] == 0
    words = ("run", "--protocol", protocol, "--jobs", 1, "--pairs", 0)
    code, shown, _ = command(*words, "--out", tmp_path / "a")
    assert code == 0
    assert "Registered: protocol, models" in shown
    content: dict[str, Any] = yaml.safe_load(protocol.read_text())
    protocol.write_text(yaml.safe_dump(content | {"seed": 8}))
    code, _, error = command(*words, "--out", tmp_path / "b")
    assert code == 2
    assert "small.registration.json (today) no longer fits: the protocol; say --exploratory" in error
    assert error.count("\n") == 1
    code, shown, _ = command(*words, "--out", tmp_path / "b", "--exploratory")
    assert code == 0
    assert "Exploratory: no registration" in shown
    assert "Exploratory: no registration" in (tmp_path / "b" / "report.html").read_text()
