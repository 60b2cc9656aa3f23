"""Perception: objects on the table and a target for the hand, from a depth camera's points; functions of arrays.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.cell.perception.fits.model import Solid
    from allegro_twin.cell.perception.pipeline import Detection, PerceptionPipeline
    from allegro_twin.cell.perception.settings import PerceptionSettings
    from allegro_twin.cell.perception.target import GraspTarget, grasp_target

__all__ = [
    "Detection",
    "GraspTarget",
    "PerceptionPipeline",
    "PerceptionSettings",
    "Solid",
    "grasp_target",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "fits.model": ("Solid",),
        "pipeline": (
            "Detection",
            "PerceptionPipeline",
        ),
        "settings": ("PerceptionSettings",),
        "target": (
            "GraspTarget",
            "grasp_target",
        ),
    },
)
