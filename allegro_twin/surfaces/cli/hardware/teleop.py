"""The command `teleop`: a tracked human hand controls the robot hand."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import completion, options
from allegro_twin.surfaces.cli.options import OtherHand

if TYPE_CHECKING:
    from allegro_twin.spec import Side
    from allegro_twin.surfaces.teleop.follower import FrameCounts

WEBCAM = "webcam"
_SWITCH = 0.0005  # s that this thread may delay the control loop's; Python's default, 5 ms, exceeds a period.


def teleop(
    config: Annotated[
        str, typer.Argument(help="Config of the hand, by path or name.", autocompletion=completion.configs)
    ],
    source: Annotated[str, typer.Option("--from", help="Hand tracking: a .npz, .csv or .json file, or `webcam`.")],
    other: OtherHand = None,
    tracked: Annotated[
        Literal["right", "left"] | None, typer.Option(help="Which hand of the person; default: the file's, else right.")
    ] = None,
    speed: Annotated[float, typer.Option(help="Maximum joint speed, rad/s.", callback=options.positive)] = 2.0,
    patience: Annotated[
        float,
        typer.Option(help="Time without a tracked hand until the robot hand stops, s.", callback=options.positive),
    ] = 0.3,
    model: Annotated[Path | None, typer.Option(help="For a webcam: MediaPipe's file hand_landmarker.task.")] = None,
    camera: Annotated[int | None, typer.Option(help="Number of the webcam; default: 0.", min=0)] = None,
    view: Annotated[bool, typer.Option(help="Watch in Rerun's own window.")] = False,
    web: Annotated[bool, typer.Option(help="Watch in the browser.")] = False,
) -> None:
    """Control a hand by a tracked human hand, from file or webcam."""
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand_override import on_hand
    from allegro_twin.surfaces.cli.start.view import show_live
    from allegro_twin.surfaces.teleop.session import live, open_follower, replay
    from allegro_twin.surfaces.teleop.tracks import read_track
    from allegro_twin.surfaces.teleop.webcam import Webcam
    from allegro_twin.surfaces.worker_process import WorkerProcess

    if view and web:
        raise ConfigError("--view and --web are two ways to watch one hand: choose one")
    if source == WEBCAM and model is None:
        raise ConfigError(
            "--from webcam needs --model hand_landmarker.task, MediaPipe's; docs/how-to/teleoperate.md says whence"
        )
    for option, given in (("--model", model), ("--camera", camera)):
        if given is not None and source != WEBCAM:
            raise ConfigError(f"{option} is for --from webcam, and {source} is a file: leave it out")
    settings = on_hand(load_config(config), other)
    track = None if source == WEBCAM else read_track(_find_track(Path(source)))
    told = None if track is None else track.side
    if tracked is not None and told not in (None, tracked):
        raise ConfigError(f"{source} is of a {told} hand by its `side`, not {tracked}: leave --tracked out")
    side: Side = tracked or told or "right"
    sys.setswitchinterval(_SWITCH)
    with ExitStack() as stack:
        watcher = None
        if model is not None and track is None:
            watcher = stack.enter_context(WorkerProcess(Webcam(model, side, camera or 0)))
        opened = open_follower(settings, side, _report, speed=speed, patience=patience)
        hand, follower = stack.enter_context(opened)
        console.say(f"{hand.spec.name} follows {source}; Ctrl-C ends it")
        if view or web:
            show_live(hand, web=web)
        if track is not None:
            replay(hand, track, follower)
        elif watcher is not None:
            live(hand, watcher, follower)
        console.console.print(_summary(follower.tally), soft_wrap=True)


def _find_track(path: Path) -> Path:
    from allegro_twin.files.assets import data_root

    shipped = data_root() / path
    return shipped if not path.exists() and shipped.is_file() else path


def _summary(tally: FrameCounts) -> str:
    return (
        f"{tally.followed} frames followed, {tally.clipped} of them up to a joint's limit; left out: {tally.unseen} "
        f"without a hand, {tally.jumps} that jumped, {tally.late} overtaken"
    )


def _report(line: str) -> None:
    from allegro_twin.surfaces.cli import console

    console.warn(line)
