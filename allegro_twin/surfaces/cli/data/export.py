"""Commands that convert recordings, bus logs, bags and data sets, and write layouts for viewers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import completion
from allegro_twin.surfaces.cli.options import Config, OtherHand


def layout(
    target: Annotated[Path, typer.Argument(help=".json for Foxglove, .xml for PlotJuggler.")],
    config: Config = "sim_right",
    other: OtherHand = None,
) -> None:
    """Write a Foxglove or PlotJuggler layout for a hand."""
    from allegro_twin.app.config import load_config
    from allegro_twin.app.rig import spec_of
    from allegro_twin.files.atomic_write import atomic_file
    from allegro_twin.recording.messages.layouts import foxglove, plotjuggler
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand_override import on_hand

    writers = {".json": foxglove, ".xml": plotjuggler}
    if target.suffix not in writers:
        raise ConfigError(f"{target}: a layout ends in .json, for Foxglove, or .xml, for PlotJuggler")
    settings = on_hand(load_config(config), other)
    hand, text = settings.hand, writers[target.suffix](spec_of(settings))
    with atomic_file(target) as temporary:
        temporary.write_text(text)
    console.say(f"{target}: the layout of {hand.model}_{hand.side}")


def export(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            help="A recording (.arrow), a bus log (.blf, .asc, candump's .log), a bag (.mcap, .bag, rosbag2) or a data "
            "set; several recordings make one data set."
        ),
    ],
    target: Annotated[
        Path,
        typer.Argument(
            help="Output: .parquet, .csv, .rrd, .mcap; .arrow from a log, bag or data set; a new folder for a set."
        ),
    ],
    partial: Annotated[bool, typer.Option(help="Read as much as possible of a recording that was cut short.")] = False,
    kind: Annotated[
        str | None, typer.Option("--format", help="Format of a new folder: lerobot, minari or rosbag2.")
    ] = None,
    episode: Annotated[int | None, typer.Option(help="Which episode of a data set; default: 0, the first.")] = None,
    config: Annotated[
        str | None,
        typer.Option(
            help="Config of the hand: in a bus log or a bag; of a recording, where its card has moved.",
            autocompletion=completion.configs,
        ),
    ] = None,
    bus: Annotated[str | None, typer.Option(help="Which bus, for a log of several.")] = None,
    track: Annotated[str | None, typer.Option(help="Which track of a `lab` recording: hand or arm.")] = None,
    topic: Annotated[str | None, typer.Option(help="Topic of a bag; default: its only joint_states.")] = None,
) -> None:
    """Convert recordings, bags, bus logs and data sets."""
    from allegro_twin.recording.exchange.rosbag import is_bag
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.data import convert

    first, bag, source = recordings[0], is_bag(recordings[0]), ""
    log = target.suffix == ".arrow" and not first.is_dir() and kind is None and not bag
    if first.suffix == target.suffix == ".arrow":
        raise ConfigError(f"{first} is a recording already: export it to .mcap, .parquet, .csv, .rrd or a data set")
    framed = kind == "rosbag2" or (kind is None and target.suffix in (".mcap", ".rrd") and not first.is_dir())
    back = kind is None and first.is_dir() and not bag
    for name, value, read, what in (
        (
            "--config",
            config,
            log or bag or framed,
            "a bus log, a bag, or a recording that becomes .mcap, .rrd or rosbag2",
        ),
        ("--bus", bus, log, "a bus log"),
        ("--topic", topic, bag and kind is None, "a bag"),
        ("--episode", episode, back, "a data set"),
        ("--track", track, not (log or back or bag or kind), "a lab run's recording"),
        ("--partial", partial or None, not (log or back or bag), "a recording"),
    ):
        if value is not None and not read:
            raise ConfigError(f"{name} is for {what}; {first} to {target} is none")
    if kind is not None:
        rows = convert.to_dataset(recordings, target, kind, partial=partial, config=config)
    elif len(recordings) != 1:
        raise ConfigError(f"{len(recordings)} recordings make one data set: give --format lerobot or minari")
    elif bag:
        rows, source, left_out = convert.from_bag(first, target, config, topic)
        for line in left_out:
            console.warn(line)
    elif back:
        rows = convert.from_dataset(first, target, episode or 0)
    elif log:
        rows, notes = convert.from_log(first, target, config, bus)
        console.warn(notes)
    else:
        rows = convert.convert(first, target, partial=partial, track=track, config=config)
    console.say(f"{target}: {rows} rows{source and f' of {source}'}")
