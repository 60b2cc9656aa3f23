"""One run of the cell that several tests look at."""

from __future__ import annotations

import pytest

from allegro_twin.cell.journal.observers import ObserverCamera, Observers
from allegro_twin.cell.journal.recording import SessionRecorder
from allegro_twin.cell.run import LabReport, perform
from allegro_twin.recording.reader import CellRecording, load_cell
from tests.cell.test_run import cell_of


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[CellRecording, LabReport]:
    path, cell = tmp_path_factory.mktemp("lab") / "lab.arrow", cell_of()
    recorded, lens = SessionRecorder(cell, path), ObserverCamera(cell, 2.0)
    looking = Observers(cell, [recorded], lens)
    report = perform(cell, arm=looking.arm, hand=looking.hand, on_state=looking.on_state, on_prepare=looking.on_prepare)
    for each in (recorded, lens, cell):
        each.close()
    return load_cell(path), report
