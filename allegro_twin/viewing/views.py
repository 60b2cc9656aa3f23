"""Views: camera directions and picture sizes, the same names for films, stills and Rerun."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.types import Array

NAMES = ("auto", "front", "side", "top", "palm")
DEFAULT = "side"
AUTO = "auto"
"""Like `side`, a little higher; stills of a trial turn to where most of the grip is seen."""
_MIRROR = np.diag([1.0, -1.0, 1.0])
_HAND = 0.12  # m. From a palm to the middle of its grasp, at most.
LARGEST = 8192
"""Pixels along an edge: what OpenGL drivers are sure to have."""


@dataclass(frozen=True, slots=True)
class View:
    """A place to look from, on a sphere around the middle of the grasp, as a right hand sees it."""

    azimuth: float
    """Azimuth of the viewing direction about the world's vertical, degrees; the left hand is seen from the mirror
    image."""
    elevation: float
    """Elevation of the viewing direction, degrees: negative from above."""
    distance: float
    """m."""

    def direction(self, side: str = "right") -> Array:
        """The unit vector of looking in the world, (3,)."""
        azimuth, elevation = math.radians(self.azimuth), math.radians(self.elevation)
        x, y = math.cos(azimuth) * math.cos(elevation), math.sin(azimuth) * math.cos(elevation)
        return np.array([x, y if side == "right" else -y, math.sin(elevation)])


@dataclass(frozen=True, slots=True, eq=False)
class Aim:
    """A hand as something to look at: the middle of its grasp and its own directions, in the palm's frame, (3,)."""

    middle: Array
    """m."""
    ahead: Array
    """Where straight fingers point."""
    inward: Array
    """Where they curl to: out of the palm."""


def aim(straight: Array, bent: Array) -> Aim:
    """From where the last links of the fingers are in the palm's frame, straight and half bent, (f, 3), m each."""
    far, near = straight.mean(axis=0), bent.mean(axis=0)
    ahead = far / np.linalg.norm(far)
    inward = near - (near @ ahead) * ahead
    return Aim((far + near) / 3.0, ahead, inward / max(float(np.linalg.norm(inward)), 1e-9))


def view(name: str, target: Aim, palm: Array) -> View:
    """A named view or `AZIMUTH,ELEVATION,DISTANCE`. `palm` is the right hand's orientation in the world, (3, 3).

    `auto` is `side` from higher, where the shadow is in the picture. `front` sees the fingertips from ahead, `side` the
    gap between thumb and fingers, `top` from above, `palm` what the fingers close on. Raises ConfigError for anything
    else.
    """
    if "," in name:
        return _given(name)
    ahead, inward = palm @ target.ahead, palm @ target.inward
    across = np.cross(inward, ahead)
    match name:
        case "front":
            return _from(ahead + 0.35 * inward, -15.0, 0.42)
        case "auto":
            return _from(-across + 0.35 * ahead + 0.15 * inward, -25.0, 0.45)
        case "side":
            return _from(-across + 0.35 * ahead + 0.15 * inward, -14.0, 0.42)
        case "top":
            return View(_from(-ahead, 0.0, 0.5).azimuth, -80.0, 0.5)
        case "palm":
            elevation = -math.degrees(math.asin(np.clip(inward[2], -1.0, 1.0)))
            place = inward if abs(inward[2]) < 0.9 else ahead + 0.1 * inward
            return _from(place, float(np.clip(elevation, -60.0, -8.0)), 0.42)
    raise ConfigError(f"camera {name}: {', '.join(NAMES)}, or AZIMUTH,ELEVATION,DISTANCE (degrees, m)")


def aimed_view(name: str | View, side: str, straight: Array, bent: Array, palm: Array) -> tuple[Aim, View]:
    """What to look at and from where. `straight` and `bent` as for `aim`; `palm` is its orientation, (3, 3)."""
    target = aim(straight, bent)
    if isinstance(name, View):
        return target, name
    if side == "right":
        return target, _stood_back(view(name, target, palm), name, target)
    return target, view(name, aim(straight @ _MIRROR, bent @ _MIRROR), _MIRROR @ palm @ _MIRROR)


def checked(name: str) -> str:
    """The name of a view, if it is one. Raises ConfigError."""
    view(name, Aim(np.zeros(3), np.eye(3)[2], np.eye(3)[0]), np.eye(3))
    return name


def size(text: str) -> tuple[int, int]:
    """Width and height of `1280x720`, pixels. Raises ConfigError."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isascii() and part.isdecimal() for part in parts):
        raise ConfigError(f"--size {text}: a width and a height in pixels, like 1280x720")
    width, height = (int(part) for part in parts)
    if not (16 <= width <= LARGEST and 16 <= height <= LARGEST):
        raise ConfigError(f"--size {text}: each edge is from 16 to {LARGEST} pixels")
    return width, height


def check_edges(width: object, height: object) -> None:
    """Raise ConfigError for what is no width or height of a picture, pixels."""
    for name, value in (("width", width), ("height", height)):
        if not isinstance(value, int | np.integer) or isinstance(value, bool) or not 1 <= value <= LARGEST:
            raise ConfigError(f"{name} is a whole number of pixels from 1 to {LARGEST}, not {value!r}")


def _from(place: Array, elevation: float, distance: float) -> View:
    """Looking back from a place, whose height counts nothing."""
    return View(math.degrees(math.atan2(-place[1], -place[0])), elevation, distance)


def _stood_back(place: View, name: str, target: Aim) -> View:
    """A named view of something that is larger than a hand, from as far as that needs."""
    size = float(np.linalg.norm(target.middle))
    return place if "," in name else replace(place, distance=place.distance * max(size / _HAND, 1.0))


def _given(text: str) -> View:
    try:
        azimuth, elevation, distance = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(f"camera {text}: three numbers AZIMUTH,ELEVATION,DISTANCE (degrees, m)") from None
    if not (math.isfinite(azimuth) and abs(elevation) <= 90.0 and 0.05 <= distance <= 10.0):
        raise ConfigError(f"camera {text}: elevation within ±90 degrees and distance from 0.05 to 10 m")
    return View(azimuth, elevation, distance)
