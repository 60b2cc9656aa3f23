"""The hand in MuJoCo. Imported before MuJoCo, this chooses how to render where there is no screen."""

from __future__ import annotations

import ctypes
import os
import sys
from typing import TYPE_CHECKING

from allegro_twin._lazy import exports


def _choose_renderer() -> str:
    """MuJoCo decides at its import how to render: without a screen GLFW would end the process at the first picture,
    and EGL without its library, or one of OpenGL's, would break the import. So: EGL where they are, else none."""
    return "egl" if _loads("libEGL.so.1") and (_loads("libOpenGL.so.0") or _loads("libGL.so.1")) else "disable"


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


if sys.platform == "linux" and not os.environ.get("DISPLAY") and not os.environ.get("MUJOCO_GL"):
    os.environ["MUJOCO_GL"] = _choose_renderer()

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
