"""The help says in one line what each command does, in panels, and is there at once."""

from __future__ import annotations

import subprocess
import sys

import pytest
import typer

from allegro_twin.surfaces.cli import main
from tests.surfaces.cli.conftest import Run

WIDTH = 64
"""Characters of a help line that fit beside the name of a command in a terminal of 80 columns."""
COMMANDS = typer.main.get_command(main.app).commands  # type: ignore[attr-defined]  # A group.


def test_every_command_stands_in_one_panel_and_the_panels_are_these() -> None:
    panels = {name: command.rich_help_panel for name, command in COMMANDS.items()}
    assert set(panels.values()) == {"Start", "Grasps", "Hardware", "Learning", "Twin", "Cell", "Data", "Machine"}
    registered = [command for commands in main.PANELS.values() for command in commands]
    assert len(registered) == len(set(registered)) == len(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_a_command_is_one_line_in_the_list(name: str) -> None:
    line = COMMANDS[name].get_short_help_str(limit=200)
    assert 0 < len(line) <= WIDTH, line


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_with_many_options_shows_them_in_panels(name: str) -> None:
    options = [parameter for parameter in COMMANDS[name].params if parameter.opts[0].startswith("-")]
    panels = {getattr(option, "rich_help_panel", None) for option in options}
    assert len(options) <= 13 or len(panels) > 1


def test_every_option_and_argument_says_what_it_is() -> None:
    silent = [f"{name} {parameter.name}" for name, command in COMMANDS.items() for parameter in command.params
              if not getattr(parameter, "help", None)]  # fmt: skip
    assert silent == []


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("run", "record image video rrd wire_log"), ("mirror", "record rrd"), ("branch", "record rrd image"),
        ("lab", "film"), ("mpc", "film"), ("evaluate", "film"), ("identify", "report"), ("lab-look", "out"),
        ("firmware", "report wire_log"),
    ],
)  # fmt: skip
def test_an_option_that_names_a_file_says_that_it_replaces_it(name: str, wanted: str) -> None:
    said = {each.name: str(getattr(each, "help", "")) for each in COMMANDS[name].params}
    for option in wanted.split():
        assert "replaces" in said[option], (option, said[option])
        assert len(said[option]) <= WIDTH, said[option]


def test_the_help_loads_neither_numpy_nor_pydantic_nor_a_simulator() -> None:
    code = "import sys, allegro_twin.surfaces.cli.main; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0] for name in done.stdout.split()}
    assert loaded & {"numpy", "pydantic", "mujoco", "pinocchio", "pyarrow", "yaml"} == set()


def test_what_ends_without_a_folder_says_how_to_keep_it(command: Run) -> None:
    code, out, errors = command("evaluate", "golf_ball", "--protocol", "quick")
    assert code == 0, errors
    assert "Next: --out FOLDER keeps the results" in out
