"""The list of environments."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from allegro_twin.cli.main import app
from allegro_twin.errors import ConfigError


def test_the_environments_are_listed_with_their_spaces_and_what_they_are_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("allegro_twin.cli.console.console.width", 200, raising=False)
    text = " ".join(CliRunner().invoke(app, ["envs", "Reorient"]).stdout.split())
    for part in ("AllegroTwin/Reorient-v0", "observation 77", "16 in [-1, 1]", "privileged", "769"):
        assert part in text


def test_an_unknown_task_is_answered_with_the_nearest() -> None:
    result = CliRunner().invoke(app, ["envs", "Lfit"])
    assert isinstance(result.exception, ConfigError)
    assert "did you mean 'Lift'" in str(result.exception)
