"""Watching: the command that shows a recording in Rerun, and the live view of a hand or a cell."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import options

if TYPE_CHECKING:
    from allegro_twin.cell.assembly import Cell
    from allegro_twin.surfaces.hand import Hand
    from allegro_twin.viewing.rerun.viewer import Viewer

Camera = Annotated[
    str,
    typer.Option(
        help="Viewpoint: auto (stills turn to the grip), front, side, top, palm, or "
        "AZIMUTH,ELEVATION,DISTANCE (degrees, m).",
        rich_help_panel=options.OUTPUT,
    ),
]


def view(
    recording: Annotated[Path, typer.Argument(help="A .arrow recording, or the folder of a `lab` run.")],
    web: Annotated[bool, typer.Option(help="Show it in the browser, not in Rerun's own window.")] = False,
    port: Annotated[int, typer.Option(help="TCP port of the page in the browser.", callback=options.port)] = 9090,
    camera: Camera = "side",
    partial: Annotated[bool, typer.Option(help="Read as much as possible of a recording that was cut short.")] = False,
) -> None:
    """Show a recording in Rerun."""
    from allegro_twin.surfaces.cli import console
    from allegro_twin.viewing import views

    cell = cell_recording(recording)
    if cell is not None:
        _keep_open(*_show_cell(cell, web=web, port=port, partial=partial))
        return
    with console.progress() as bar:
        task = bar.add_task("reading", total=None)
        viewer, url = show(
            recording, web=web, port=port, partial=partial, camera=views.checked(camera),
            total=lambda n: bar.update(task, total=n), advance=lambda: bar.advance(task),
        )  # fmt: skip
    _keep_open(viewer, url)


def show(
    path: Path,
    *,
    web: bool,
    port: int,
    partial: bool,
    camera: str,
    total: Callable[[int], None],
    advance: Callable[[], None],
) -> tuple[Any, str]:
    """Play a hand's recording into a Rerun viewer.

    Returns the viewer, which keeps its page alive, and the address of the page. `total` gets the number of samples
    once, `advance` is called for each. Raises RecordingError, and ConfigError without Rerun."""
    from allegro_twin.app.session import rerun_stage
    from allegro_twin.recording.reader import load
    from allegro_twin.recording.replay import ReplayBackend, replay_samples

    recording = load(path, partial=partial)
    total(len(recording))
    viewer_of, shown = rerun_stage()
    from allegro_twin.viewing.scenery import scenery

    viewer = viewer_of(recording.spec, scenery(recording.spec, recording.meta), view=camera)
    url = viewer.serve(open_browser=True, web_port=port) if web else ""
    if not web:
        viewer.spawn()
    backend = ReplayBackend(recording)
    for _ in shown(replay_samples(backend), viewer, backend.extras):
        advance()
    add_verdict(viewer, recording)
    viewer.flush()
    return viewer, url


def add_verdict(viewer: Any, recording: Any) -> None:
    """Write the verdict on a recorded trial into its Rerun view; a recording without a trial has none."""
    from allegro_twin.grasping.evaluation.rejudge import phase_results, rejudge, report_markdown

    report = rejudge(recording.spec, recording.columns, recording.meta)
    if report is not None:
        viewer.conclude(phase_results(report), report_markdown(report, recording.spec.thermal))
    elif (pulled := recording.columns.get("mouse_force")) is not None and pulled.any():
        largest = float((pulled**2).sum(axis=1).max()) ** 0.5
        viewer.conclude({}, f"no verdict: the mouse pulled an object with up to {largest:.1f} N")


def show_live(hand: Hand, *, web: bool) -> None:
    """Show every sample of a hand from now on, in Rerun's own window or in the browser."""
    from allegro_twin.app.session import rerun_stage
    from allegro_twin.surfaces.cli import console

    viewer_of, _ = rerun_stage()
    viewer = viewer_of(hand.spec, live=True)
    if web:
        console.say(f"Open {viewer.serve()}")
    else:
        viewer.spawn()
    hand.listen(lambda sample: viewer.draw(sample, {}))


def cell_recording(path: Path) -> Path | None:
    """The recording of a cell: the file itself, or the one in the folder of a run. None for anything else."""
    from allegro_twin.cell.journal.observers import RECORDING
    from allegro_twin.recording.reader import is_cell_recording

    if path.is_dir():
        return path / RECORDING if (path / RECORDING).is_file() else None
    return path if path.is_file() and is_cell_recording(path) else None


def cell_to_rrd(path: Path, target: Path, *, partial: bool) -> int:
    """Write the recording of a cell as a Rerun file. Returns the number of events in it."""
    from allegro_twin.recording.events import session_events
    from allegro_twin.recording.reader import load_cell

    recording = load_cell(path, partial=partial)
    found = list(session_events(recording))
    _rerun().write_events(found, _rerun().viewer_of(recording), target)
    return len(found)


def cell_viewer(cell: Cell) -> Viewer:
    """A Rerun viewer for a running cell. Raises ConfigError without Rerun."""
    from allegro_twin.cell.journal.recording import cell_look
    from allegro_twin.viewing.scenery import scenery

    scene = scenery(cell.hand.spec, {"look": cell_look(cell)})
    viewer: Viewer = _rerun().Viewer(cell.hand.spec, scene, arm=cell.robot.spec, live=True)
    return viewer


def _show_cell(path: Path, *, web: bool, port: int, partial: bool) -> tuple[Any, str]:
    """Play the recording of a cell into a Rerun viewer. Returns the viewer and the address of its page."""
    from allegro_twin.recording.events import session_events
    from allegro_twin.recording.reader import load_cell

    recording = load_cell(path, partial=partial)
    viewer = _rerun().viewer_of(recording)
    url = viewer.serve(open_browser=True, web_port=port) if web else ""
    if not web:
        viewer.spawn()
    for event in session_events(recording):
        viewer.on_event(event)
    viewer.flush()
    return viewer, url


def _rerun() -> Any:
    try:
        from allegro_twin.viewing.rerun import viewer
    except ImportError as error:
        raise ConfigError(f"viewing a cell needs Rerun: pip install 'allegro-twin[view]' ({error})") from error
    return viewer


def _keep_open(viewer: Any, url: str) -> None:
    """Keep a page in the browser alive until Ctrl-C; Rerun's own window needs no program."""
    from allegro_twin.surfaces.cli import console

    if url:
        console.say(f"Open {url} (Ctrl-C ends it)")
        _wait()
    viewer.close()


def _wait() -> None:
    try:
        signal.pause()
    except KeyboardInterrupt:
        return
