"""One picture of a depth camera, with when and from where it was taken."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from allegro_twin.cell.camera.intrinsics import Cloud, Image, Intrinsics
from allegro_twin.cell.camera.mount import CameraPose


@dataclass(frozen=True, eq=False)
class Frame:
    """What the camera tells of one moment."""

    number: int
    """Pictures since the camera was switched on; one that is skipped or repeated shows here."""
    time: float
    """When it was taken, s of the scene's clock."""
    ready: float
    """When a program can have it, s: `time` and the latency."""
    depth: Image
    """(rows, columns), m along z; NaN is unknown."""
    colour: NDArray[np.uint8] | None
    """(rows, columns, RGB) of the colour camera, which stands beside; None where none was asked for."""
    lens: Intrinsics
    """Of `depth`."""
    pose: CameraPose
    """In the world when it was taken, which on a moving wrist is not where the camera is now."""

    @cached_property
    def cloud(self) -> Cloud:
        """A point a pixel, (rows, columns, 3), m in the camera's frame; NaN is unknown."""
        return self.lens.cloud(self.depth)
