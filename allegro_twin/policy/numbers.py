"""The constants that a policy's interface reckons with, lying where its arrays do (allegro_twin/arrays.py)."""

from __future__ import annotations

from typing import NamedTuple

from allegro_twin.types import Array, Vector


class Numbers(NamedTuple):
    """Shape (n,) where nothing else is said."""

    step: Vector
    middle: Vector
    rest: Vector
    lower: Vector
    upper: Vector
    span: Vector
    kp: Vector
    kd: Vector
    limit: Vector
    scale: Vector
    """What the numbers of an observation are divided by, (frame,)."""
    parts: Vector
    """How much of the way to the new offset is behind the target, a period each, (decimation,)."""
    scripts: tuple[Array, Array] | None
    """Set-points and their rates, (s, t, n)."""
