"""The command that lets a recording go on otherwise."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from allegro_twin.surfaces.cli import complete, options


class Disturbances(StrEnum):
    forget = "forget"
    hold = "hold"


def branch(
    recording: Annotated[Path, typer.Argument(help="A recording (.arrow) of a simulated, a virtual or a real hand.")],
    at: Annotated[float, typer.Option(help="From when on it goes on otherwise, s.")],
    change: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="friction=0.5 (of contacts; of a simulation alone), damping=…, frictionloss=… (of all joints), "
            "strength=0.8 (what its motors give of what they gave), or controller.gains=v4.",
        ),
    ] = None,
    hand: Annotated[
        str | None,
        typer.Option(
            help="Go on with this model of the hand, from what a mirror knows; default of a real hand: the file it was "
            "recorded with.",
            autocompletion=complete.hands,
        ),
    ] = None,
    disturbance: Annotated[
        Disturbances, typer.Option(help="With a model: what becomes of what pushes the joints at that instant.")
    ] = Disturbances.forget,
    open_loop: Annotated[
        bool, typer.Option("--open-loop", help="With a model: the recorded commands go on, not the controller.")
    ] = False,
    gravity: Annotated[
        str | None, typer.Option(help="In the palm's frame, m/s², of a hand that does not report it: 0,0,-9.81.")
    ] = None,
    record: Annotated[
        Path | None, typer.Option(help="Record it to this .arrow.", callback=options.file(".arrow"))
    ] = None,
    rrd: Annotated[
        Path | None,
        typer.Option(help="Both futures in one Rerun file: the hand, and as it was.", callback=options.file(".rrd")),
    ] = None,
    image: Annotated[
        Path | None, typer.Option(help="All futures drawn joint by joint, .png.", callback=options.file(".png"))
    ] = None,
) -> None:
    """What if: let a recording go on otherwise from some instant, and compare both futures. A simulation is repeated;
    of a hand on a bus or a line its model goes on, and once more without the change: what that is off by is the model's
    own error."""
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.twins import branching, mirroring
    from allegro_twin.twin.branch.result import BranchOptions

    down = None if gravity is None else mirroring.vector(gravity)
    wanted = BranchOptions(hand or "", disturbance.value, open_loop, down)
    found = branching.branched(recording, at, change or [], branching.Kept(record, rrd), wanted)
    for line in branching.doubts(recording, wanted):
        console.warn(line)
    if image is not None:
        branching.picture(image, recording, found, at)
    console.console.print(branching.table(recording, found, at))
    for line in branching.lines(found, at):
        console.console.print(line, highlight=False, soft_wrap=True)
