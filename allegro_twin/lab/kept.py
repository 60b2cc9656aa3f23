"""What is kept of a run: pictures at three moments, and a recording of the arm and one of the hand."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from allegro_twin.lab.cell import Room
from allegro_twin.lab.run import Stage
from allegro_twin.lab.states import Now, State
from allegro_twin.look.camera import Camera
from allegro_twin.look.saved import save
from allegro_twin.look.views import View
from allegro_twin.replay.recorder import recorded
from allegro_twin.types import Sample

PICTURES: dict[State, str] = {"ToTargetPose": "before", "ToLiftedPose": "grasp", "Done": "end"}
"""What is taken when a state begins, by the name of the file."""
_VIEW = View(azimuth=125.0, elevation=-25.0, distance=1.35)
_SIZE = (640, 480)


class Kept:
    """Writes into a folder. Raises ConfigError where nothing can be rendered, RecordingError for the disk."""

    def __init__(self, room: Room, folder: Path) -> None:
        self._room, self._folder = room, folder
        self._camera = Camera(room.cell.hand_sim, width=_SIZE[0], height=_SIZE[1], view=_VIEW)

    def entered(self, now: Now) -> None:
        """A state begins."""
        name = PICTURES.get(now.state)
        if name is not None:
            save(self._camera.take(), self._folder / f"{name}.png")

    def stage(self, what: str) -> Stage:
        """That records the arm or the hand: `arm` or `hand`."""
        backend = self._room.arm if what == "arm" else self._room.hand

        def kept(samples: Iterable[Sample]) -> Iterator[Sample]:
            path = self._folder / f"{what}.arrow"
            return recorded(samples, path, backend.spec, backend.period, meta={"lab": what})

        return kept

    def close(self) -> None:
        """Let go of the pictures' screen."""
        self._camera.close()
