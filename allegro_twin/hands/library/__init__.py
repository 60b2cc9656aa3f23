"""The library: postures, grasps, trajectories and gains as files, and how they are written.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.hands.library.entries import grasp_entry, posture_entry, trajectory_entry

__all__ = [
    "grasp_entry",
    "posture_entry",
    "trajectory_entry",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "entries": (
            "grasp_entry",
            "posture_entry",
            "trajectory_entry",
        ),
    },
)
