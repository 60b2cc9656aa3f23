"""Controllers and what they follow: PD and PID, gravity compensation, trajectories, force grasps.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.control.controllers import (
        PD,
        PID,
        ConstantTorque,
        Gains,
        GravityCompensation,
        GravityFeedforward,
        PositionControl,
    )
    from allegro_twin.control.trajectory import Hold, Moves, SetPoint, Trajectory, Waypoint

__all__ = [
    "PD",
    "PID",
    "ConstantTorque",
    "Gains",
    "GravityCompensation",
    "GravityFeedforward",
    "Hold",
    "Moves",
    "PositionControl",
    "SetPoint",
    "Trajectory",
    "Waypoint",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "controllers": (
            "PD",
            "PID",
            "ConstantTorque",
            "Gains",
            "GravityCompensation",
            "GravityFeedforward",
            "PositionControl",
        ),
        "trajectory": ("Hold", "Moves", "SetPoint", "Trajectory", "Waypoint"),
    },
)
