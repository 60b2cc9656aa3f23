"""The command that says what works on this computer, what does not, and what mends it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from allegro_twin.surfaces.cli.checks.finding import Finding

_MARKS = {"works": "[green]works[/]", "absent": "[yellow]absent[/]", "broken": "[red]broken[/]"}


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(doctor)


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="For a program, or a bug report.")] = False,
) -> None:
    """Look at this computer: versions, extras, pictures, CAN, cameras, real time, ports; what does not work, and what
    mends it. Ends with 2 where something is broken."""
    from allegro_twin.surfaces.cli import console

    found = list(findings())
    if as_json:
        console.console.print_json(json.dumps([finding._asdict() for finding in found]))
    else:
        console.console.print(table(found))
    if any(finding.status == "broken" for finding in found):
        raise typer.Exit(2)


def findings() -> Iterator[Finding]:
    """Every check, one after the other."""
    from allegro_twin.surfaces.cli.checks import bus, machine, packages

    yield from packages.python()
    yield from packages.packages()
    yield from packages.rospy()
    yield from machine.libraries()
    yield from machine.scheduling()
    yield from machine.pictures()
    yield from machine.cards()
    yield from bus.interfaces()
    yield from bus.adapters()
    yield from machine.cameras()
    yield from machine.ports()


def table(found: list[Finding]) -> Table:
    """For a terminal."""
    from rich.markup import escape
    from rich.table import Table

    shown = Table("", "", "", "to mend it", show_edge=False)
    for what, status, says, mend in found:
        shown.add_row(what, _MARKS[status], escape(says), escape(mend))
    return shown
