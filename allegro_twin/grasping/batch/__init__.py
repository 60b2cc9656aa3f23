"""Many grasp trials in one batch.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.grasping.batch.batched_control import clamp_torques, pd_torque
    from allegro_twin.grasping.batch.trial_loop import TrialLoop, in_layouts, stacked

__all__ = [
    "TrialLoop",
    "clamp_torques",
    "in_layouts",
    "pd_torque",
    "stacked",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "batched_control": (
            "clamp_torques",
            "pd_torque",
        ),
        "trial_loop": (
            "TrialLoop",
            "in_layouts",
            "stacked",
        ),
    },
)
