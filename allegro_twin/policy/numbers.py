"""The constants that a policy's interface reckons with, lying where its arrays do (allegro_twin/arrays.py)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from allegro_twin.control.controllers import Gains
from allegro_twin.policy.script import Scripts
from allegro_twin.spec import HandSpec
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


def radian_of(spec: HandSpec) -> Vector:
    """What a radian of a joint is in positions of its motor, (n,): 1; but where motors move joints through tendons or
    linkages as much of the motor's range as a radian is of a quarter turn."""
    span = spec.upper - spec.lower
    return span / (np.pi / 2) if spec.followers else np.ones_like(span)


def numbers_of(
    spec: HandSpec,
    gains: Gains,
    sizes: tuple[Vector, Vector, Vector, Vector],
    decimation: int,
    scripts: Scripts | None,
    xp: Any,
) -> Numbers:
    """`sizes`: half the range, what a speed is divided by, the largest offset and the step of a decision, (n,) each."""
    half, speed, span, step = sizes
    limit = spec.actuation.torque_limit
    scale = np.concatenate([half, speed, limit, span, [] if scripts is None else [float(scripts.periods)]])
    place, middle = xp.asarray, (spec.lower + spec.upper) / 2
    return Numbers(
        step=place(step),
        middle=place(middle),
        rest=place(np.zeros_like(middle)),
        lower=place(spec.lower),
        upper=place(spec.upper),
        span=place(span),
        kp=place(gains.kp),
        kd=place(gains.kd),
        limit=place(limit),
        scale=place(scale),
        parts=place(np.arange(1, decimation + 1) / decimation),
        scripts=None if scripts is None else (place(scripts.position), place(scripts.velocity)),
    )
