"""Motion of arm and fingers: which paths, past what, and where a close on nothing ends.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.cell.motion.arm_motion import ArmGuide, GuidedImpedance, SetpointPath

__all__ = [
    "ArmGuide",
    "GuidedImpedance",
    "SetpointPath",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "arm_motion": (
            "ArmGuide",
            "GuidedImpedance",
            "SetpointPath",
        ),
    },
)
