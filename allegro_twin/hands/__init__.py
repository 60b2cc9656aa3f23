"""Hands: their specs, and the library of postures, grasps, trajectories and gains.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.hands.description.specs import hand_side, load_spec
    from allegro_twin.hands.library.gains import load_gains
    from allegro_twin.hands.library.grasps import Grasp
    from allegro_twin.hands.library.library import Library, load_grasp, load_posture, load_trajectory, posture_names
    from allegro_twin.hands.limits import hand_limits
    from allegro_twin.hands.settings import LimitSettings

__all__ = [
    "Grasp",
    "Library",
    "LimitSettings",
    "hand_limits",
    "hand_side",
    "load_gains",
    "load_grasp",
    "load_posture",
    "load_spec",
    "load_trajectory",
    "posture_names",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "description.specs": (
            "hand_side",
            "load_spec",
        ),
        "library.gains": ("load_gains",),
        "library.grasps": ("Grasp",),
        "library.library": (
            "Library",
            "load_grasp",
            "load_posture",
            "load_trajectory",
            "posture_names",
        ),
        "limits": ("hand_limits",),
        "settings": ("LimitSettings",),
    },
)
