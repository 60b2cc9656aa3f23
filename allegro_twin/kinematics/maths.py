"""Elementary functions of one kind of value, so that a formula is written once for a number and for an array.

Sums, products and roots round alike in both, and so do NumPy's sine, cosine and tangent of one number and of many; an
arc tangent may differ in its last bit. So what a single call finds is what a batch finds, but for that bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from allegro_twin.types import Array

T = TypeVar("T", float, Array)
"""A number, or one for every target of a batch, shape (N,)."""


@dataclass(frozen=True, slots=True)
class Maths(Generic[T]):
    """Functions of numbers, or of arrays. A condition is the result of a comparison of two values."""

    sin: Callable[[T], T]
    cos: Callable[[T], T]
    exact_circle: Callable[[T], tuple[T, T]]
    """Cosine and sine of an angle that is held: they decide where two links meet, and there every bit counts."""
    circle: Callable[[T], tuple[T, T]]
    """Cosine and sine, where the last bit does not count."""
    atan: Callable[[T], T]
    atan2: Callable[[T, T], T]
    acos: Callable[[T], T]
    cbrt: Callable[[T], T]
    copysign: Callable[[T, T], T]
    root: Callable[[T], T]
    """√max(x, 0)."""
    wrap: Callable[[T, float], T]
    """Equivalent angle within π of another, rad."""
    where: Callable[[object, T | float, T | float], T]
    """The second where the first holds, else the third."""
    any: Callable[[object], bool]
    """Whether a condition holds for any value."""


def _exact_circle(angle: float) -> tuple[float, float]:
    return _circle_of(float(np.tan(angle / 2)))


def _exact_circles(angle: Array) -> tuple[Array, Array]:
    """With t = tan(φ/2): (1 - t²) / (1 + t²) and 2 t / (1 + t²). NumPy's tangent is the fastest of the three by far."""
    return _circle_of(np.tan(angle / 2))


def _circle_of(t: T) -> tuple[T, T]:
    whole = 1.0 + t * t
    return (1.0 - t * t) / whole, (t + t) / whole


def _circle(angle: float) -> tuple[float, float]:
    return math.cos(angle), math.sin(angle)


def _root(x: float) -> float:
    return 0.0 if x <= 0.0 else math.sqrt(x)  # NaN stays NaN, as in an array.


def _wrap(angle: float, middle: float) -> float:
    away = angle - middle
    return angle - 2 * math.pi * round(away / (2 * math.pi)) if abs(away) > math.pi else angle


def _where(condition: object, then: float, otherwise: float) -> float:
    return then if condition else otherwise


def _roots(x: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(x, 0.0)))


def _wrap_all(angle: Array, middle: float) -> Array:
    return np.asarray(angle - 2 * math.pi * np.rint((angle - middle) / (2 * math.pi)))


def _where_all(condition: object, then: Array | float, otherwise: Array | float) -> Array:
    return np.where(condition, then, otherwise)  # type: ignore[call-overload, no-any-return]  # A comparison's flags.


def _any(condition: object) -> bool:
    return bool(np.any(condition))  # type: ignore[call-overload]  # As above.


FLOATS: Maths[float] = Maths(
    math.sin, math.cos, _exact_circle, _circle, math.atan, math.atan2, math.acos, math.cbrt,
    math.copysign, _root, _wrap, _where, bool,
)  # fmt: skip
ARRAYS: Maths[Array] = Maths(
    np.sin, np.cos, _exact_circles, _exact_circles, np.arctan, np.arctan2, np.arccos, np.cbrt,
    np.copysign, _roots, _wrap_all, _where_all, _any,
)  # fmt: skip
