"""Kinematics and statics: `hand_kinematics` for any hand, `ArmModel` for an arm, and orientations.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.kinematics.arm import ArmModel
    from allegro_twin.kinematics.finger import FingerKinematics
    from allegro_twin.kinematics.hand import HandKinematics, hand_kinematics
    from allegro_twin.kinematics.orientation import (
        euler_from_matrix,
        matrix_from_euler,
        matrix_from_quaternion,
        quaternion_from_matrix,
    )
    from allegro_twin.kinematics.pose import Pose
    from allegro_twin.kinematics.solutions import Best, Nearest, Solutions

__all__ = [
    "ArmModel",
    "Best",
    "FingerKinematics",
    "HandKinematics",
    "Nearest",
    "Pose",
    "Solutions",
    "euler_from_matrix",
    "hand_kinematics",
    "matrix_from_euler",
    "matrix_from_quaternion",
    "quaternion_from_matrix",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "arm": ("ArmModel",),
        "finger": ("FingerKinematics",),
        "hand": ("HandKinematics", "hand_kinematics"),
        "orientation": ("euler_from_matrix", "matrix_from_euler", "matrix_from_quaternion", "quaternion_from_matrix"),
        "pose": ("Pose",),
        "solutions": ("Best", "Nearest", "Solutions"),
    },
)
