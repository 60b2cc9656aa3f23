"""Editors that know the schemas accept every file that ships, and show what a person types wrongly."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.files.schema import json_schema
from allegro_twin.surfaces.cli.data.schemas import PLACES, models
from tests.snapshots import assert_snapshot, settings_text
from tests.surfaces.cli.conftest import Run

jsonschema = pytest.importorskip("jsonschema", reason="needs jsonschema: extra dev")


@pytest.fixture(scope="module")
def schemas() -> dict[str, dict[str, Any]]:
    return {kind: json_schema(model, kind) for kind, model in models().items()}


@pytest.mark.parametrize("kind", PLACES)
def test_every_file_that_ships_is_valid(schemas: dict[str, dict[str, Any]], kind: str) -> None:
    jsonschema.Draft202012Validator.check_schema(schemas[kind])
    validator = jsonschema.Draft202012Validator(schemas[kind])
    files = sorted(data_root().glob(PLACES[kind]))  # As an editor does: a cell's are configs' and labs', too.
    assert files
    for path in files:
        content = read_yaml(path)
        assert not [error.message for error in validator.iter_errors(content)], path


@pytest.mark.parametrize(
    ("kind", "content"),
    [
        ("config", {"backend": {"kind": "sim", "facng": [1, 0, 0]}, "controller": {"kind": "pid"}}),
        ("config", {"backend": {"kind": "sim"}, "controller": {"kind": "pid"}, "period": -1}),
        ("config", {"backend": {"kind": "symulation"}, "controller": {"kind": "pid"}}),
        ("config", {"controller": {"kind": "pid"}}),
        ("config", {"backend": {"kind": "sim"}, "controller": {"kind": "pid"}, "perod": 0.003}),
        ("lab", {"arm": {"model": "ferr"}, "objects": []}),
        ("posture", {"angles": {"index": "straight"}}),
        ("protocol", {"phases": "all"}),
        ("grasp", {}),
    ],
)
def test_what_is_wrong_is_shown(schemas: dict[str, dict[str, Any]], kind: str, content: dict[str, Any]) -> None:
    assert list(jsonschema.Draft202012Validator(schemas[kind]).iter_errors(content))


def test_an_editor_shows_the_unit_that_the_code_says(schemas: dict[str, dict[str, Any]]) -> None:
    assert schemas["config"]["properties"]["period"]["description"] == "s. The hand reports every 3 ms."
    can = schemas["config"]["$defs"]["CanSettings"]["properties"]
    assert can["bitrate"]["description"].startswith("bit/s.")
    hidden = schemas["config"]["$defs"]["SceneSettings"]["properties"]
    assert hidden["start"]["description"].startswith("Joint positions at reset"), "of the class above it"


def test_the_command_writes_them_and_says_how_an_editor_finds_them(command: Run, tmp_path: Path) -> None:
    code, out, _ = command("schemas", tmp_path / "schemas")
    assert code == 0
    assert {path.name for path in (tmp_path / "schemas").iterdir()} == {f"{kind}.schema.json" for kind in PLACES}
    assert json.loads((tmp_path / "schemas/config.schema.json").read_text())["title"] == "allegro-twin: config"
    assert "yaml.schemas" in out


def test_what_can_be_set_is_what_it_was_unless_somebody_says_otherwise() -> None:
    """A default or a bound is changed on purpose, and then looked at here: those who left a key out get the new one."""
    assert_snapshot(settings_text(*models().values()), Path(__file__).with_name("snapshots") / "settings.txt")


def test_a_path_with_brackets_is_printed_as_it_is(command: Run, tmp_path: Path) -> None:
    code, shown, _ = command("schemas", tmp_path / "mine[view]")
    assert code == 0
    assert f"schemas in {tmp_path / 'mine[view]'};" in shown
