"""Advice that names an option names one that exists, where it can be taken."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import allegro_twin
from tests.surfaces.cli.conftest import Run
from tests.surfaces.cli.wrong import built
from tests.test_architecture import parsed

OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]+")
OTHERS = {
    "--check",
    "--force-reinstall",
    "--help",
    "--param",
    "--ros-args",
    "--system-site-packages",
    "--upgrade",
    "--version",
}
"""Of other programs, such as pip, and of every one."""
NO_ADVICE = ("viewing/report/html.py", "viewing/rerun/server.py", "drivers/base/suspend.py")
"""Style sheets, and what Rerun and systemd-inhibit are started with."""


def below(group: Any, name: str = "") -> Iterator[tuple[str, set[str]]]:
    for key, each in getattr(group, "commands", {}).items():
        yield from below(each, f"{name} {key}".strip())
        yield (
            f"{name} {key}".strip(),
            {option for param in each.params for option in (*param.opts, *param.secondary_opts)},
        )


def named() -> Iterator[tuple[str, str]]:
    """Every option that a text of the package names, and where."""
    root = Path(allegro_twin.__file__).parent
    for path in sorted(root.rglob("*.py")):
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                for option in OPTION.findall(node.value):
                    yield option, f"{path.relative_to(root)}:{node.lineno}"


def test_every_option_that_a_message_names_is_one_of_a_command() -> None:
    there = set().union(*(options for _, options in below(built())))
    assert not [
        f"{where}: {option}"
        for option, where in named()
        if option not in there | OTHERS and not where.startswith(NO_ADVICE)
    ]


def test_a_cut_recording_names_the_commands_that_take_what_is_there(command: Run, tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text("backend: {kind: sim}\ncontroller: {kind: pd}\nseconds: 1.5\n")
    assert command("run", tmp_path / "p.yaml", "--record", tmp_path / "r.arrow")[0] == 0
    (tmp_path / "cut.arrow").write_bytes((tmp_path / "r.arrow").read_bytes()[:-2000])
    code, _, said = command("gap", tmp_path / "cut.arrow")
    assert (code, said.count("\n")) == (2, 1)
    takers = re.findall(r"`(\w+)`", said.split("--partial")[0])
    commands = dict(below(built()))
    assert takers == ["run", "view", "mirror", "export"]
    assert all("--partial" in commands[name] for name in takers)
    assert "--partial" not in commands["gap"]
