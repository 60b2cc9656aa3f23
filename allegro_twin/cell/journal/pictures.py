"""Pictures of a run at three moments, for a person."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.cell.assembly import Room
from allegro_twin.recording.events import JournalEntry, SessionEvent
from allegro_twin.viewing.camera import Camera
from allegro_twin.viewing.png import save
from allegro_twin.viewing.views import View

PICTURES = {"ToTargetPose": "before", "ToLiftedPose": "grasp", "Done": "end"}
"""What is taken when a state begins, by the name of the file."""
RECORDING = "lab.arrow"
"""What `recorded.Recorded` writes beside them."""
_VIEW = View(azimuth=125.0, elevation=-25.0, distance=1.35)
_SIZE = (640, 480)


class Kept:
    """An onlooker that writes them into a folder. Raises ConfigError where nothing can be rendered."""

    def __init__(self, room: Room, folder: Path) -> None:
        self._folder = folder
        self._camera = Camera(room.cell.hand_sim, width=_SIZE[0], height=_SIZE[1], view=_VIEW)

    def on_event(self, event: SessionEvent) -> None:
        """Take a picture where a state begins."""
        if isinstance(event, JournalEntry) and event.track == "states":
            name = PICTURES.get(event.row["state"])
            if name is not None:
                save(self._camera.take(), self._folder / f"{name}.png")

    def close(self) -> None:
        """Let go of the pictures' screen."""
        self._camera.close()
