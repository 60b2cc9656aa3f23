"""Rendering backend of MuJoCo on this computer, chosen at import by the environment variable MUJOCO_GL."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Mapping

from allegro_twin.errors import ConfigError, unknown

OFF = ("disable", "disabled", "off", "false", "0")
ON = ("egl", "osmesa", "glfw", "glx", "enable", "enabled", "on", "true", "1")
"""Values of MUJOCO_GL that MuJoCo takes on Linux, in any case."""
EGL_PACKAGES = "apt-get install libegl1 libopengl0 libgl1-mesa-dri"
_OSMESA = ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")
_OWN: list[str] = []
"""What this process has chosen, where nobody else has."""


def loads(library: str) -> bool:
    """Whether a shared library can be loaded."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def has_egl(load: Callable[[str], bool] = loads) -> bool:
    """Whether EGL and one of OpenGL's libraries are there."""
    return load("libEGL.so.1") and (load("libOpenGL.so.0") or load("libGL.so.1"))


def choose_renderer() -> None:
    """Choose before MuJoCo is imported, which decides then: without a screen GLFW would end the process at the first
    picture, and EGL without its libraries would break the import. So: EGL where they are, else none. A value of
    MUJOCO_GL that is set stays. Raises ConfigError for one with which MuJoCo cannot be imported."""
    if sys.platform != "linux" or "mujoco" in sys.modules:
        return
    given = os.environ.get("MUJOCO_GL", "").strip()
    if given:
        check_value(given)
    elif not os.environ.get("DISPLAY"):
        os.environ["MUJOCO_GL"] = chosen()
        _OWN.append(os.environ["MUJOCO_GL"])


def chosen() -> str:
    """What is chosen without a screen."""
    return "egl" if has_egl() else "disable"


def check_value(given: str, load: Callable[[str], bool] = loads) -> None:
    """Raise ConfigError for a value of MUJOCO_GL that ends the import of MuJoCo on this computer."""
    value = given.lower()
    if value not in OFF + ON:
        raise ConfigError(f"{unknown('value of MUJOCO_GL', given, (*ON[:3], 'off'))}; unset it, and it is chosen")
    if value == "egl" and not has_egl(load):
        raise ConfigError(f"MUJOCO_GL={given}: EGL's libraries are not there: {EGL_PACKAGES}, or unset MUJOCO_GL")
    if value == "osmesa" and not any(map(load, _OSMESA)):
        raise ConfigError(
            f"MUJOCO_GL={given}: its library is not there: apt-get install libosmesa6, or unset MUJOCO_GL"
        )


def rendering_hint(environment: Mapping[str, str] = os.environ) -> str:
    """What to do where nothing can be rendered."""
    value = environment.get("MUJOCO_GL", "").strip()
    if value and value not in _OWN:
        if value.lower() in OFF:
            return f"MUJOCO_GL={value} switches pictures off: unset it"
        if value.lower() != "egl":
            return f"MUJOCO_GL={value} does not render here: unset it, or set MUJOCO_GL=egl, which needs no screen"
    return (f"pictures without a screen need EGL: {EGL_PACKAGES}; and MUJOCO_GL=egl in a program that imports mujoco "
            "before allegro_twin")  # fmt: skip
