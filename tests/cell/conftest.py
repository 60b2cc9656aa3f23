"""One run of the cell that several tests look at."""

from __future__ import annotations

import pytest

from allegro_twin.cell.journal.observers import Onlookers
from allegro_twin.cell.journal.recording import Recorded
from allegro_twin.cell.journal.second_camera import Lens
from allegro_twin.cell.run import Report, perform
from allegro_twin.recording.reader import CellRecording, load_cell
from tests.cell.test_run import room_of


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[CellRecording, Report]:
    path, room = tmp_path_factory.mktemp("lab") / "lab.arrow", room_of()
    recorded, lens = Recorded(room, path), Lens(room, 2.0)
    looking = Onlookers(room, [recorded], lens)
    report = perform(room, arm=looking.arm, hand=looking.hand, entered=looking.entered, prepared=looking.prepared)
    for each in (recorded, lens, room):
        each.close()
    return load_cell(path), report
