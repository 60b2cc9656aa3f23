"""Checks of array arguments: numbers of the shape that a function needs, or a ConfigError in one line."""

from __future__ import annotations

from reprlib import Repr
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.types import Array, Vector

_SHORT = Repr()
_SHORT.maxother = _SHORT.maxstring = 60
FURTHEST = 1e9
"""m. Of a point further away doubles do not tell which posture is nearest."""


def numbers(what: str, value: ArrayLike | None) -> Array:
    """A value as doubles. Raises ConfigError for what is no array of real numbers."""
    try:
        if isinstance(value, np.ndarray | np.generic) and np.iscomplexobj(value):
            raise TypeError
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{what} must be numbers, not {short_repr(value)}") from error


def rows(what: str, value: ArrayLike | None, *last: int) -> Array:
    """Numbers of shape (..., *last). Raises ConfigError for another."""
    array = numbers(what, value)
    if array.shape[-len(last) :] != last:
        raise ConfigError(f"{what} needs shape (..., {', '.join(map(str, last))}); it has {array.shape}")
    return array


def finite(what: str, value: ArrayLike | None, *shape: int) -> Array:
    """Finite numbers of one shape. Raises ConfigError for others."""
    array = numbers(what, value)
    if array.shape != shape:
        raise ConfigError(f"{what} needs {f'shape {shape}' if shape else 'one number'}; it has shape {array.shape}")
    if not np.isfinite(array).all():
        place = tuple(map(int, np.argwhere(~np.isfinite(array))[0]))
        where = f"number {', '.join(map(str, place))} of it" if shape else "it"
        raise ConfigError(f"{what} must be finite; {where} is {array[place]}")
    return array


def too_far(finger: str, points: Array) -> ConfigError:
    """The error for points, (..., 3), m, of which one is further away than `FURTHEST`."""
    return ConfigError(f"{finger}: position is in m, at most {FURTHEST:g}; it is {np.abs(points).max():g}")


def check_margin(finger: str, margin: float, lower: Vector, upper: Vector) -> None:
    """Raise ConfigError for a margin to joint limits, (k,) each, rad, that leaves some joint no range."""
    half = float((upper - lower).min()) / 2
    if not 0.0 <= margin < half:
        raise ConfigError(f"{finger}: margin {margin} rad does not fit; half the least range is {half:.3f} rad")


def short_repr(value: Any) -> str:
    """A value in a part of one line."""
    return " ".join(_SHORT.repr(value).split())
