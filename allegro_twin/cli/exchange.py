"""The command that turns recordings, bus logs and data sets into each other."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from allegro_twin.errors import ConfigError


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(export)


def export(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            help="A .arrow recording, or a bus log: .blf, .log (candump), .asc; for a data set, several recordings."
        ),
    ],
    target: Annotated[
        Path,
        typer.Argument(help="Where to: .parquet, .csv or .rrd; .arrow for a bus log; a new folder for a data set."),
    ],
    partial: Annotated[bool, typer.Option(help="Export what is readable of a recording that was cut short.")] = False,
    kind: Annotated[str | None, typer.Option("--format", help="Of a data set: lerobot or minari.")] = None,
    episode: Annotated[int, typer.Option(help="Of a data set that becomes a recording again.")] = 0,
    config: Annotated[str | None, typer.Option(help="Of the hand in a bus log.")] = None,
    bus: Annotated[str | None, typer.Option(help="Which bus of a log that holds several.")] = None,
) -> None:
    """Convert recordings for other programs: files, data sets of demonstrations; and data sets and bus logs into
    recordings."""
    from allegro_twin.cli import console, demonstrations
    from allegro_twin.cli.runs import convert, from_log

    if kind is not None:
        rows = demonstrations.packed(recordings, target, kind, partial=partial)
    elif len(recordings) != 1:
        raise ConfigError(f"{len(recordings)} recordings make one data set: give --format lerobot or minari")
    elif recordings[0].is_dir():
        rows = demonstrations.unpacked(recordings[0], target, episode)
    elif target.suffix == ".arrow":
        rows, notes = from_log(recordings[0], target, config, bus)
        if notes:
            console.errors.print(f"[yellow]{notes}[/]", soft_wrap=True)
    else:
        rows = convert(recordings[0], target, partial=partial)
    console.console.print(f"{target}: {rows} rows")
