"""The command `doctor`: what works on this computer, what does not, and the fix."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from allegro_twin.surfaces.cli.machine.finding import Diagnosis

_MARKS = {"works": "[green]works[/]", "absent": "[yellow]absent[/]", "broken": "[red]broken[/]"}


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, for a program or a bug report.")] = False,
) -> None:
    """Check this computer: packages, graphics, CAN, ports.

    Each problem has the line that fixes it. The exit code is 2 if something is broken."""
    from allegro_twin.surfaces.cli import console

    found = list(findings())
    if as_json:
        console.console.print_json(json.dumps([finding._asdict() for finding in found]))
    else:
        console.console.print(table(found))
    if any(finding.status == "broken" for finding in found):
        raise typer.Exit(2)


def findings() -> Iterator[Diagnosis]:
    """All findings, check by check."""
    from allegro_twin.surfaces.cli.machine import bus, computer, packages

    yield from packages.python()
    yield from packages.packages()
    yield from packages.rospy()
    yield from computer.libraries()
    yield from computer.scheduling()
    yield from computer.pictures()
    yield from computer.cards()
    yield from bus.interfaces()
    yield from bus.adapters()
    yield from computer.cameras()
    yield from computer.ports()


def table(found: list[Diagnosis]) -> Table:
    """Table of findings for a terminal."""
    from rich.markup import escape
    from rich.table import Table

    shown = Table("", "", "", "to mend it", show_edge=False)
    for what, status, says, mend in found:
        shown.add_row(what, _MARKS[status], escape(says), escape(mend))
    return shown
