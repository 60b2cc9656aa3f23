"""Grasp planning in the cell: stored grasps, the arm's reach, and grasps adapted to new solids.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.cell.planning.adaptation import GraspAdapter
    from allegro_twin.cell.planning.reachability import GraspPlan, plan_grasp

__all__ = [
    "GraspAdapter",
    "GraspPlan",
    "plan_grasp",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "adaptation": ("GraspAdapter",),
        "reachability": (
            "GraspPlan",
            "plan_grasp",
        ),
    },
)
