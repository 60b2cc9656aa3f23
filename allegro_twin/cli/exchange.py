"""The command that turns recordings, bus logs and data sets into each other."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from allegro_twin.cli import complete
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
    episode: Annotated[
        int | None, typer.Option(help="Of a data set that becomes a recording again; default: the first, 0.")
    ] = None,
    config: Annotated[
        str | None, typer.Option(help="Of the hand in a bus log.", autocompletion=complete.configs)
    ] = None,
    bus: Annotated[str | None, typer.Option(help="Which bus of a log that holds several.")] = None,
) -> None:
    """Convert recordings for other programs: files, data sets of demonstrations; and data sets and bus logs into
    recordings."""
    from allegro_twin.cli import console, demonstrations
    from allegro_twin.cli.runs import convert, from_log

    first, log = recordings[0], target.suffix == ".arrow" and not recordings[0].is_dir() and kind is None
    back = kind is None and first.is_dir()
    for name, value, read, what in (
        ("--config", config, log, "a bus log"),
        ("--bus", bus, log, "a bus log"),
        ("--episode", episode, back, "a data set"),
        ("--partial", partial or None, not (log or back), "a recording"),
    ):
        if value is not None and not read:
            raise ConfigError(f"{name} is for {what} that is read; {first} to {target} reads none")
    if kind is not None:
        rows = demonstrations.packed(recordings, target, kind, partial=partial)
    elif len(recordings) != 1:
        raise ConfigError(f"{len(recordings)} recordings make one data set: give --format lerobot or minari")
    elif back:
        rows = demonstrations.unpacked(first, target, episode or 0)
    elif log:
        rows, notes = from_log(first, target, config, bus)
        if notes:
            console.errors.print(f"[yellow]{notes}[/]", soft_wrap=True)
    else:
        rows = convert(first, target, partial=partial)
    console.console.print(f"{target}: {rows} rows")
