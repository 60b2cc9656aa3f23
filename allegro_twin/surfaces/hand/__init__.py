"""`Hand`, the facade for people at a prompt."""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.surfaces.hand.external_setpoints import ExternalSetpoints
    from allegro_twin.surfaces.hand.facade import Hand

__all__ = [
    "ExternalSetpoints",
    "Hand",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "external_setpoints": ("ExternalSetpoints",),
        "facade": ("Hand",),
    },
)
