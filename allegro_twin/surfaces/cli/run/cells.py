"""Looking at a whole cell: live, or its recording in Rerun or as a file of Rerun's."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from allegro_twin.errors import ConfigError

if TYPE_CHECKING:
    from allegro_twin.cell.assembly import Cell
    from allegro_twin.viewing.rerun.viewer import Viewer


def recording_in(path: Path) -> Path | None:
    """A cell's recording: the file itself, or the one in a run's folder. None: it is something else."""
    from allegro_twin.cell.journal.observers import RECORDING
    from allegro_twin.recording.reader import is_cell_recording

    if path.is_dir():
        return path / RECORDING if (path / RECORDING).is_file() else None
    return path if path.is_file() and is_cell_recording(path) else None


def show(path: Path, *, web: bool, port: int, partial: bool) -> tuple[Any, str]:
    """Play a cell's recording into a Rerun viewer. The viewer, whose page lives as long as it, and the page's
    address."""
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


def to_rrd(path: Path, target: Path, *, partial: bool) -> int:
    """Write a cell's recording for Rerun; how many events it has."""
    from allegro_twin.recording.events import session_events
    from allegro_twin.recording.reader import load_cell

    recording = load_cell(path, partial=partial)
    found = list(session_events(recording))
    _rerun().write_events(found, _rerun().viewer_of(recording), target)
    return len(found)


def live(cell: Cell) -> Viewer:
    """A viewer for a cell that works now. Raises ConfigError without Rerun."""
    from allegro_twin.cell.journal.recording import cell_look
    from allegro_twin.viewing.scenery import scenery

    scene = scenery(cell.hand.spec, {"look": cell_look(cell)})
    found: Viewer = _rerun().Viewer(cell.hand.spec, scene, arm=cell.robot.spec, live=True)
    return found


def _rerun() -> Any:
    try:
        from allegro_twin.viewing.rerun import viewer
    except ImportError as error:
        raise ConfigError(f"looking needs Rerun: pip install 'allegro-twin[view]' ({error})") from error
    return viewer
