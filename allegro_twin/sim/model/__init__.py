"""MuJoCo model of a hand, made from its card, and queries of it.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.sim.model.physics import Cone
    from allegro_twin.sim.model.scene import Stage, compile_scene
    from allegro_twin.sim.model.wrist import WristSegment, WristServo, set_wrist_servo, wrist_load, wrist_set_points

__all__ = [
    "Cone",
    "Stage",
    "WristSegment",
    "WristServo",
    "compile_scene",
    "set_wrist_servo",
    "wrist_load",
    "wrist_set_points",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "physics": ("Cone",),
        "scene": (
            "Stage",
            "compile_scene",
        ),
        "wrist": (
            "WristSegment",
            "WristServo",
            "set_wrist_servo",
            "wrist_load",
            "wrist_set_points",
        ),
    },
)
