"""A depth camera in a simulated scene: what it sees, with what errors, when, and its faults.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import allegro_twin.sim as sim  # noqa: F401  # It chooses how MuJoCo renders, which must come before MuJoCo.
from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.cell.camera.camera import CameraFrame, CameraStream, CellCamera, DepthCamera
    from allegro_twin.cell.camera.settings import DepthCameraSettings
    from allegro_twin.cell.camera.sources import open_camera

__all__ = [
    "CameraFrame",
    "CameraStream",
    "CellCamera",
    "DepthCamera",
    "DepthCameraSettings",
    "open_camera",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "camera": (
            "CameraFrame",
            "CameraStream",
            "CellCamera",
            "DepthCamera",
        ),
        "settings": ("DepthCameraSettings",),
        "sources": ("open_camera",),
    },
)
