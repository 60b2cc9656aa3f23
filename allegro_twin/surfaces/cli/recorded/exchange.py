"""The commands that turn recordings, bus logs, bags and data sets into each other, and layouts to see them in."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import complete
from allegro_twin.surfaces.cli.options import Config, OtherHand


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    app.command()(export)
    app.command()(layout)


def layout(
    target: Annotated[Path, typer.Argument(help=".json for Foxglove, .xml for PlotJuggler.")],
    config: Config = "sim_right",
    other: OtherHand = None,
) -> None:
    """Write a layout in which Foxglove or PlotJuggler shows a bag, or the topics, of a hand."""
    from allegro_twin.app.config import load_config
    from allegro_twin.files.atomic_write import atomic_file
    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.recording.messages.layouts import foxglove, plotjuggler
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.performers import on_hand

    writers = {".json": foxglove, ".xml": plotjuggler}
    if target.suffix not in writers:
        raise ConfigError(f"{target}: a layout ends in .json, for Foxglove, or .xml, for PlotJuggler")
    hand = on_hand(load_config(config), other).hand
    text = writers[target.suffix](load_spec(hand.model, hand.side, hand.serial))
    with atomic_file(target) as temporary:
        temporary.write_text(text)
    console.console.print(f"{target}: the layout of {hand.model}_{hand.side}", soft_wrap=True)


def export(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            help="A .arrow recording; a bus log: .blf, .log (candump), .asc; a bag: .mcap, .bag, a folder of rosbag2; "
            "for a data set, several recordings."
        ),
    ],
    target: Annotated[
        Path,
        typer.Argument(
            help="Where to: .parquet, .csv, .rrd or .mcap; .arrow for a bus log or a bag; a new folder for a data set."
        ),
    ],
    partial: Annotated[bool, typer.Option(help="Export what is readable of a recording that was cut short.")] = False,
    kind: Annotated[str | None, typer.Option("--format", help="Of a new folder: lerobot, minari or rosbag2.")] = None,
    episode: Annotated[
        int | None, typer.Option(help="Of a data set that becomes a recording again; default: the first, 0.")
    ] = None,
    config: Annotated[
        str | None, typer.Option(help="Of the hand in a bus log or a bag.", autocompletion=complete.configs)
    ] = None,
    bus: Annotated[str | None, typer.Option(help="Which bus of a log that holds several.")] = None,
    track: Annotated[str | None, typer.Option(help="Of a lab run's recording: hand or arm.")] = None,
) -> None:
    """Convert recordings for other programs: files, data sets of demonstrations; and data sets and bus logs into
    recordings."""
    from allegro_twin.recording.exchange.rosbag import is_bag
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.recorded import bags, demonstrations
    from allegro_twin.surfaces.cli.run.runs import convert, from_log

    first, bag = recordings[0], is_bag(recordings[0])
    log = target.suffix == ".arrow" and not first.is_dir() and kind is None and not bag
    back = kind is None and first.is_dir() and not bag
    for name, value, read, what in (
        ("--config", config, log or bag, "a bus log or a bag"),
        ("--bus", bus, log, "a bus log"),
        ("--episode", episode, back, "a data set"),
        ("--track", track, not (log or back or bag or kind), "a lab run's recording"),
        ("--partial", partial or None, not (log or back or bag), "a recording"),
    ):
        if value is not None and not read:
            raise ConfigError(f"{name} is for {what} that is read; {first} to {target} reads none")
    if kind is not None:
        rows = demonstrations.packed(recordings, target, kind, partial=partial)
    elif len(recordings) != 1:
        raise ConfigError(f"{len(recordings)} recordings make one data set: give --format lerobot or minari")
    elif bag:
        rows = bags.unpacked(first, target, config)
    elif back:
        rows = demonstrations.unpacked(first, target, episode or 0)
    elif log:
        rows, notes = from_log(first, target, config, bus)
        console.warn(notes)
    else:
        rows = convert(first, target, partial=partial, track=track)
    console.console.print(f"{target}: {rows} rows")
