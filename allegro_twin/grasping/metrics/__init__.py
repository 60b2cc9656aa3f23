"""Grasp metrics from contacts alone: pure functions of arrays; equations in docs/reference/grasp_metrics.md.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.grasping.metrics.contacts import Contacts, make_contacts
    from allegro_twin.grasping.metrics.quality import GraspQuality, grasp_quality

__all__ = [
    "Contacts",
    "GraspQuality",
    "grasp_quality",
    "make_contacts",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "contacts": (
            "Contacts",
            "make_contacts",
        ),
        "quality": (
            "GraspQuality",
            "grasp_quality",
        ),
    },
)
