"""The hand in MuJoCo. Imported before MuJoCo, this chooses how to render where there is no screen."""

from __future__ import annotations

import ctypes
import os
import sys


def _choose_renderer() -> str:
    """MuJoCo decides at its import how to render: without a screen GLFW would end the process at the first picture,
    and EGL without its library would break the import. So: EGL where it is, else none."""
    try:
        ctypes.CDLL("libEGL.so.1")
    except OSError:
        return "disable"
    return "egl"


if sys.platform == "linux" and not os.environ.get("DISPLAY") and not os.environ.get("MUJOCO_GL"):
    os.environ["MUJOCO_GL"] = _choose_renderer()
