"""Looking on: the command that shows a recording, and a live hand in Rerun."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from allegro_twin.surfaces.cli import options

if TYPE_CHECKING:
    from allegro_twin.surfaces.hand import Hand

Camera = Annotated[
    str, typer.Option(help="From where: front, side, top, palm, or AZIMUTH,ELEVATION,DISTANCE (degrees, m).")
]


def register(app: typer.Typer) -> None:
    """Add these commands to the command line."""
    app.command()(view)


def view(
    recording: Annotated[Path, typer.Argument(help="A .arrow recording, or a lab run's folder.")],
    web: Annotated[bool, typer.Option(help="In the browser instead of Rerun's own window.")] = False,
    port: Annotated[int, typer.Option(help="Of the page in the browser.", callback=options.port)] = 9090,
    camera: Camera = "side",
    partial: Annotated[bool, typer.Option(help="Show what is readable of a recording that was cut short.")] = False,
) -> None:
    """Look at a recording in Rerun."""
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.run import cells
    from allegro_twin.surfaces.cli.run.runs import show
    from allegro_twin.viewing import views

    cell = cells.recording_in(recording)
    if cell is not None:
        _seen(*cells.show(cell, web=web, port=port, partial=partial))
        return
    with console.progress() as bar:
        task = bar.add_task("reading", total=None)
        viewer, url = show(
            recording, web=web, port=port, partial=partial, camera=views.checked(camera),
            total=lambda n: bar.update(task, total=n), advance=lambda: bar.advance(task),
        )  # fmt: skip
    _seen(viewer, url)


def _seen(viewer: Any, url: str) -> None:
    """Until somebody has seen it."""
    from allegro_twin.surfaces.cli import console

    if url:
        console.console.print(f"Open {url} (Ctrl-C ends it)", soft_wrap=True)
        _wait()
    viewer.close()


def _wait() -> None:
    try:
        signal.pause()
    except KeyboardInterrupt:
        return


def show_live(hand: Hand, *, web: bool) -> None:
    """Every sample of a hand from now on, in Rerun's own window or in the browser."""
    from allegro_twin.app.session import rerun_stage
    from allegro_twin.surfaces.cli import console

    viewer_of, _ = rerun_stage()
    viewer = viewer_of(hand.spec, live=True)
    if web:
        console.console.print(f"Open {viewer.serve()}", soft_wrap=True)
    else:
        viewer.spawn()
    hand.listen(lambda sample: viewer.draw(sample, {}))
