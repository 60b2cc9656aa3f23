"""The command by which a person's tracked hand leads a robot's."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.spec import Side
from allegro_twin.surfaces.cli import complete, options
from allegro_twin.surfaces.cli.options import OtherHand

if TYPE_CHECKING:
    from allegro_twin.surfaces.teleop.follower import FrameCounts

WEBCAM = "webcam"
_TURNS = 0.0005  # s that this thread may keep the loop's thread waiting; Python's own 5 ms are longer than a period.


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(teleop)


def teleop(
    config: Annotated[
        str, typer.Argument(help="Which hand: a config by path or name.", autocompletion=complete.configs)
    ],
    source: Annotated[str, typer.Option("--from", help="A .npz, .csv or .json of hand tracking, or `webcam`.")],
    other: OtherHand = None,
    tracked: Annotated[
        Side | None, typer.Option(help="Which of the person's hands; without it what the file says, or right.")
    ] = None,
    speed: Annotated[float, typer.Option(help="Of joints at most, rad/s.", callback=options.positive)] = 2.0,
    patience: Annotated[
        float, typer.Option(help="Without a hand for so long the robot's holds, s.", callback=options.positive)
    ] = 0.3,
    model: Annotated[
        Path | None, typer.Option(help="For a webcam: MediaPipe's hand_landmarker.task, from its documentation.")
    ] = None,
    camera: Annotated[int, typer.Option(help="Which webcam.", min=0)] = 0,
    view: Annotated[bool, typer.Option(help="Watch in Rerun's own window.")] = False,
    web: Annotated[bool, typer.Option(help="Watch in the browser.")] = False,
) -> None:
    """A person's tracked hand leads a robot's, from a file or a webcam; Ctrl-C ends it and leaves the hand limp."""
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.performers import on_hand
    from allegro_twin.surfaces.cli.run.looking import show_live
    from allegro_twin.surfaces.teleop.session import live, open_follower, replay
    from allegro_twin.surfaces.teleop.tracks import read_track
    from allegro_twin.surfaces.teleop.webcam import Webcam
    from allegro_twin.surfaces.worker_process import WorkerProcess

    if view and web:
        raise ConfigError("--view and --web are two ways to watch one hand: choose one")
    if source == WEBCAM and model is None:
        raise ConfigError("--from webcam needs --model hand_landmarker.task, MediaPipe's; docs/teleop.md says whence")
    settings = on_hand(load_config(config), other)
    track = None if source == WEBCAM else read_track(_here_or_shipped(Path(source)))
    side: Side = tracked or (None if track is None else track.side) or "right"
    sys.setswitchinterval(_TURNS)
    with ExitStack() as stack:
        watcher = None
        if model is not None and track is None:
            watcher = stack.enter_context(WorkerProcess(Webcam(model, side, camera)))
        opened = open_follower(settings, side, _told, speed=speed, patience=patience)
        hand, follower = stack.enter_context(opened)
        console.console.print(f"{hand.spec.name} follows {source}; Ctrl-C ends it", soft_wrap=True, highlight=False)
        if view or web:
            show_live(hand, web=web)
        if track is not None:
            replay(hand, track, follower)
        elif watcher is not None:
            live(hand, watcher, follower)
        console.console.print(_summed(follower.tally), soft_wrap=True)


def _here_or_shipped(path: Path) -> Path:
    from allegro_twin.files.assets import data_root

    shipped = data_root() / path
    return shipped if not path.exists() and shipped.is_file() else path


def _summed(tally: FrameCounts) -> str:
    return (
        f"{tally.followed} frames followed, {tally.clipped} of them up to a joint's limit; left out: {tally.unseen} "
        f"without a hand, {tally.jumps} that jumped, {tally.late} overtaken"
    )


def _told(line: str) -> None:
    from allegro_twin.surfaces.cli import console

    console.warn(line)
