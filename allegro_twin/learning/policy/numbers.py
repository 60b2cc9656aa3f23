"""The constants that a policy's interface reckons with, lying where its arrays do (allegro_twin/array_api.py)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.array_api import take
from allegro_twin.control.controllers import Gains
from allegro_twin.learning.policy.memory import Memory
from allegro_twin.learning.policy.script import Scripts
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector


class Numbers(NamedTuple):
    """Shape (n,) where nothing else is said, or (1, …, n) as `Lifted` has them."""

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
    periods: NDArray[np.int64]
    """The numbers of these periods, from 0, (decimation,)."""
    scripts: tuple[Array, Array] | None
    """Set-points and their rates, one script after the other, (s * t, n)."""
    length: int
    """Periods of a script, t."""

    def base(self, xp: Any, memory: Memory) -> Array:
        """What offsets are counted from when a decision is taken, (..., n)."""
        return self.middle if self.scripts is None else take(self.scripts[0], self._row(xp, memory, 0), 0)

    def bases(self, xp: Any, memory: Memory) -> tuple[Array, Array]:
        """In every period until the next, with their rates, (decimation, ..., n) or (..., n) each."""
        if self.scripts is None:
            return self.middle, self.rest
        row = self._row(xp, memory, self.periods)
        return take(self.scripts[0], row, 0), take(self.scripts[1], row, 0)

    def _row(self, xp: Any, memory: Memory, later: NDArray[np.int64] | int) -> Any:
        """Where in the table of scripts a period stands; the last set-points stay."""
        return memory.script * self.length + xp.minimum(memory.tick + later, self.length - 1)


_OF_JOINTS = ("step", "middle", "rest", "lower", "upper", "span", "kp", "kd", "limit", "scale")


class Lifted:
    """The numbers with as many dimensions as what they are reckoned with: NumPy adds arrays of the same shape, as those
    of one hand then are, in a third of the time."""

    def __init__(self, numbers: Numbers) -> None:
        self._flat = numbers
        self._known: dict[int, Numbers] = {}

    def __call__(self, ndim: int) -> Numbers:
        if ndim not in self._known:
            flat, ones = self._flat, (1,) * (ndim - 1)
            wide = {name: getattr(flat, name).reshape(*ones, -1) for name in _OF_JOINTS}
            parts, periods = flat.parts.reshape(-1, *ones, 1), flat.periods.reshape(-1, *ones)
            self._known[ndim] = Numbers(**wide, parts=parts, periods=periods, scripts=flat.scripts, length=flat.length)
        return self._known[ndim]


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
        periods=place(np.arange(decimation)),
        scripts=None if scripts is None else _rows_of(scripts, place),
        length=0 if scripts is None else scripts.periods,
    )


def _rows_of(scripts: Scripts, place: Callable[[Array], Array]) -> tuple[Array, Array]:
    joints = scripts.position.shape[-1]
    return place(scripts.position.reshape(-1, joints)), place(scripts.velocity.reshape(-1, joints))
