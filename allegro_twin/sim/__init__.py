"""The hand in MuJoCo. Imported before MuJoCo, this chooses how to render where there is no screen."""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports
from allegro_twin.sim.renderer import choose_renderer

choose_renderer()

if TYPE_CHECKING:
    from allegro_twin.sim.contact.fingertip_ik import FingertipSolver
    from allegro_twin.sim.engine.backend import SimBackend
    from allegro_twin.sim.engine.hand_guiding import HandGuide
    from allegro_twin.sim.settings import SimSettings

__all__ = [
    "FingertipSolver",
    "HandGuide",
    "SimBackend",
    "SimSettings",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "contact.fingertip_ik": ("FingertipSolver",),
        "engine.backend": ("SimBackend",),
        "engine.hand_guiding": ("HandGuide",),
        "settings": ("SimSettings",),
    },
)
