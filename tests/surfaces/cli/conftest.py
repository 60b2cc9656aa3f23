"""The command line inside the test's own process, which is many times faster than one of its own."""

from __future__ import annotations

import sys
from collections.abc import Callable

import pytest
from rich.console import Console

from allegro_twin.surfaces.cli import console, main
from tests.surfaces.cli.wrong import built

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """The command line in this process: exit code, standard output and error."""
    monkeypatch.setattr(main, "app", built())

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["allegro-twin", *map(str, arguments)])
        for name in ("console", "errors"):
            monkeypatch.setattr(console, name, Console(width=160, stderr=name == "errors"))
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main.main()
        shown = capsys.readouterr()
        return int(ended.value.code or 0), shown.out, shown.err

    return run
