"""Objects to grasp: meshes, primitives and the user's own; their placement and appearance.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.sim.objects.catalogue import GraspObject, PlacedObject, load_object, object_catalogue

__all__ = [
    "GraspObject",
    "PlacedObject",
    "load_object",
    "object_catalogue",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "catalogue": (
            "GraspObject",
            "PlacedObject",
            "load_object",
            "object_catalogue",
        ),
    },
)
