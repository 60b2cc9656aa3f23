"""A second camera where the cell's is, for whoever looks on: its pictures change nothing of what the cell sees."""

from __future__ import annotations

from allegro_twin.cell.assembly import Room
from allegro_twin.cell.camera.camera import Camera
from allegro_twin.cell.camera.frame import Frame
from allegro_twin.errors import ConfigError


class Lens:
    """Pictures with colour at a rate, Hz. Raises ConfigError where nothing can be rendered, or for no rate."""

    def __init__(self, room: Room, rate: float) -> None:
        if not 0.0 < rate <= 30.0:
            raise ConfigError(f"pictures are taken at more than 0 and at most 30 Hz, not {rate:g}")
        settings, world = room.settings, room.cell.world
        self._data, self._rate, self._count = world.data, rate, 0
        self._camera = Camera(world.model, settings.camera.model_copy(update={"colour": True}), settings.seed)

    def due(self, t: float) -> Frame | None:
        """A picture of now, s, where one is due."""
        if t < self._count / self._rate - 1e-9:
            return None
        self._count = int(t * self._rate + 1e-6) + 1
        return self._camera.capture(self._data)

    def close(self) -> None:
        """Idempotent."""
        self._camera.close()
