"""One run of the cell that several tests look at."""

from __future__ import annotations

import pytest

from allegro_twin.cell.journal.observers import Lens, Onlookers
from allegro_twin.cell.journal.recording import Recorded
from allegro_twin.cell.run import Report, perform
from allegro_twin.recording.reader import Tracks, load_tracks
from tests.cell.test_run import room_of


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Tracks, Report]:
    path, room = tmp_path_factory.mktemp("lab") / "lab.arrow", room_of()
    recorded, lens = Recorded(room, path), Lens(room, 2.0)
    looking = Onlookers(room, [recorded], lens)
    report = perform(room, arm=looking.arm, hand=looking.hand, entered=looking.entered, prepared=looking.prepared)
    for each in (recorded, lens, room):
        each.close()
    return load_tracks(path), report
