"""Tables of a link check and of the frames on a bus."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable

from rich.live import Live
from rich.markup import escape
from rich.table import Table

from allegro_twin.drivers.can.link.shared_bus import Message
from allegro_twin.drivers.can.tools.findings import Finding
from allegro_twin.drivers.can.tools.sniff import Sniffer, TrafficRow, name_of
from allegro_twin.surfaces.cli import console

Heard = Iterable[tuple[float, Message | None]]
_REFRESH = 0.25  # s.


def checkup(title: str) -> Table:
    """An empty table of findings."""
    table = Table(title=f"{title}: the link, step by step", title_justify="left", title_style="bold")
    for name in ("step", "", "finding"):
        table.add_column(name)
    return table


def add(table: Table, found: Finding) -> None:
    """Add one row for a finding, with its remedy if it has one."""
    remedy = f"\n→ {found.remedy}" if found.remedy else ""
    mark = "[green]ok[/]" if found.ok else "[red]broken[/]"
    table.add_row(found.name, mark, escape(found.text + remedy))


def live(sniffer: Sniffer, heard: Heard, bus: str) -> None:
    """A live table with one row for each identifier."""
    drawn = 0.0
    with Live(rows(sniffer, bus), console=console.console, auto_refresh=False) as screen:
        for t, message in heard:
            if message is not None:
                sniffer.hear(message, t)
            if t - drawn >= _REFRESH:
                screen.update(rows(sniffer, bus), refresh=True)
                drawn = t
        screen.update(rows(sniffer, bus), refresh=True)


def lines(sniffer: Sniffer, heard: Heard) -> None:
    """One line for each frame, until the reader of the pipe ends."""
    try:
        for t, message in heard:
            if message is None:
                sys.stdout.flush()
                continue
            row = sniffer.hear(message, t)
            sys.stdout.write(f"{t:10.4f}  error frame\n" if row is None else f"{sniffer.line(row)}\n")
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Else Python reports an error when it ends.


def rows(sniffer: Sniffer, bus: str) -> Table:
    """Table of the frames so far, by identifier."""
    title = f"{bus}: {sniffer.frames} frames, {sniffer.errors} error frames; {sniffer.title()}"
    table = Table(title=escape(title), title_justify="left", title_style="bold")
    for name in ("id", "what", "count", "a second", "last", "raw"):
        table.add_column(name, justify="right" if name in ("count", "a second") else "left", no_wrap=True)
    for _, row in sorted(sniffer.rows.items()):
        table.add_row(*_cells(sniffer, row))
    return table


def _cells(sniffer: Sniffer, row: TrafficRow) -> tuple[str, ...]:
    name, text = sniffer.description(row)
    raw = "remote" if row.frame.remote else row.frame.data.hex(" ")
    rate = f"{row.rate:.1f}" if row.count > 1 else ""
    return name_of(row), escape(name), str(row.count), rate, escape(text), raw
