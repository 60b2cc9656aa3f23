"""What a policy sees and what its actions mean: one object, used by training and by every hand that a policy drives.

Everything broadcasts over leading batch dimensions `(..., n)`. A row comes out the same, bit for bit, whatever the size
of the batch it stands in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allegro_twin.array_api import take
from allegro_twin.control import laws
from allegro_twin.control.controllers import Gains
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.learning.policy.script import Scripts
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector


class Memory(NamedTuple):
    """What the interface remembers between two decisions."""

    begin: Array
    """Offset from the base when the running action was taken, shape (..., n), rad."""
    end: Array
    """Offset to be reached when the next is taken, shape (..., n), rad."""
    push: Array
    """Torque of the running action, shape (..., n), N·m; only in the mode `torque`."""
    tick: NDArray[np.int64]
    """Control periods since the beginning when the running action was taken, shape (...)."""
    script: NDArray[np.int64]
    """Which motion is followed, shape (...)."""
    past: NDArray[np.float32]
    """What was seen at the decisions before, the last one first; zeros where there were none. Shape (..., k)."""


class Course(NamedTuple):
    """Set-points of every control period from one decision to the next."""

    wish: Array | None
    """Targets, rad, and their rates, rad/s: shape (decimation, 2, ..., n); None: torque alone."""
    push: Array | None
    """Torque on top, shape (..., n), N·m."""


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


VERSION = 1
"""Of the meaning of observations and actions. A policy of another version is refused."""
MODES = ("delta", "absolute", "torque")
Mode: TypeAlias = Literal["delta", "absolute", "torque"]
Floats: TypeAlias = NDArray[np.float32]
Observation: TypeAlias = Floats | dict[str, Floats]
Goal: TypeAlias = NDArray[np.floating[Any]]
Pair: TypeAlias = tuple[Array, Array]
BOUND = 5.0
"""Every number in an observation lies within ±5: clipped, for a space must be finite."""
SPEED = 5.0  # rad/s; half the hand's no-load speed (docs/models.md#actuation), so that usual speeds are of order 1.


@dataclass(frozen=True, eq=False)
class Interface:
    """From what a hand reports to an observation, from an action in [-1, 1] to set-points, from those to what it takes.

    The base is the script's set-point or, without a script, the middle of the joint range. In the mode `delta` an
    action adds `step` times itself to the offset from the base, in `absolute` it is the offset in units of `span`; the
    target travels there in a straight line until the next decision. In `torque` it is a part of the torque limit, on
    top of what holds the script where there is one. A hand that closes its own loop is told the set-points themselves.
    """

    spec: HandSpec
    gains: Gains
    mode: Mode = "delta"
    period: float = 0.003
    """Control period, s."""
    decimation: int = 13
    """Control periods between two decisions."""
    step: float = 0.1
    """rad a decision, in the mode `delta`; as `numbers.radian_of` has it for the hand."""
    scripts: Scripts | None = None
    reach: float = 0.3
    """With a script: the farthest that a policy may go from it, rad, likewise."""
    goal: Literal["none", "fingertips"] = "none"
    """`fingertips`: where they should be in the palm frame, shape (..., 3 * fingers), m."""

    history: int = 1
    """How many decisions an observation shows, this one and those before."""
    xp: Any = np
    """Where its numbers lie: `numpy`, or `arrays.Tensors`, and then every array here is a tensor."""

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise ConfigError(f"control mode {self.mode!r} is none of {', '.join(MODES)}")
        if self.mode == "torque" and self.leads:
            raise ConfigError(
                f"{self.spec.name} closes its own loop and takes no torques: control is delta or absolute"
            )
        if self.decimation < 1:
            raise ConfigError(f"decimation {self.decimation} must be at least 1 control period a decision")

    @property
    def leads(self) -> bool:
        """Whether the hand closes its own loop, and is told where to be."""
        return "torque" not in self.spec.commands

    @cached_property
    def middle(self) -> Vector:
        return (self.spec.lower + self.spec.upper) / 2

    @cached_property
    def half(self) -> Vector:
        return (self.spec.upper - self.spec.lower) / 2

    @cached_property
    def span(self) -> Vector:
        """The largest offset from the base, shape (n,), rad."""
        return self.half if self.scripts is None else self.reach * radian_of(self.spec)

    @cached_property
    def _own(self) -> Lifted:
        """What is reckoned with at every decision, lying where the arrays do, for arrays of so many dimensions."""
        unit = radian_of(self.spec)
        sizes = self.half, SPEED * unit, self.span, self.step * unit
        return Lifted(numbers_of(self.spec, self.gains, sizes, self.decimation, self.scripts, self.xp))

    @property
    def frame(self) -> int:
        """Numbers of one decision in an observation."""
        return 4 * self.spec.n_joints + (0 if self.scripts is None else 1)

    @property
    def n_observation(self) -> int:
        return self.frame * self.history

    @property
    def n_goal(self) -> int:
        return 0 if self.goal == "none" else 3 * len(self.spec.fingers)

    @property
    def seconds(self) -> float:
        """Between two decisions."""
        return self.period * self.decimation

    def start(self, position: Array, script: NDArray[np.int64] | int = 0, target: Array | None = None) -> Memory:
        """The memory with which to meet the first state; `position` as measured, shape (..., n), rad. `target`: where
        the joints are drawn to; None: to the script's beginning, or without a script to where they are."""
        own, xp, shape = self._own(position.ndim), self.xp, position.shape[:-1]
        base = own.middle if own.scripts is None else own.scripts[0][script * own.length]
        drawn = (position if own.scripts is None else base) if target is None else target
        offset = xp.zeros(position.shape) + _within(xp, drawn - base, -own.span, own.span)
        number = xp.zeros(shape, np.int64) + xp.asarray(script, np.int64)
        past = xp.zeros((*shape, self.frame * (self.history - 1)), np.float32)
        return Memory(offset, xp.copy(offset), xp.zeros(position.shape), xp.zeros(shape, np.int64), number, past)

    def act(self, action: NDArray[np.floating[Any]], memory: Memory, seen: Floats | None = None) -> Memory:
        """Take a decision: the set-points until the next. `action` in [-1, 1], beyond it clipped, shape (..., n).
        `seen`: the observation that led to it (its goals left out), which those with a history go on showing."""
        xp, own = self.xp, self._own(memory.end.ndim)
        wish = _within(xp, xp.asarray(action, np.float64), -1.0, 1.0)
        begin, end, push, tick, script, past = memory
        if self.history > 1:
            assert seen is not None
            past = xp.concatenate([seen[..., : self.frame], past], axis=-1)[..., : past.shape[-1]]
        match self.mode:
            case "torque":
                return Memory(begin, end, wish * own.limit, tick, script, past)
            case "delta":
                return Memory(end, _within(xp, end + own.step * wish, -own.span, own.span), push, tick, script, past)
            case _:
                return Memory(end, wish * own.span, push, tick, script, past)

    def course(self, memory: Memory) -> Course:
        """The set-points from a decision to the next."""
        push = memory.push if self.mode == "torque" else None
        if push is not None and self.scripts is None:
            return Course(None, push)
        xp, own = self.xp, self._own(memory.end.ndim)
        base, speed = own.bases(xp, memory)
        travel = memory.end - memory.begin
        wish = xp.zeros((self.decimation, 2, *travel.shape))
        wish[:, 0] = _within(xp, own.parts * travel + memory.begin + base, own.lower, own.upper)
        wish[:, 1] = speed + travel / self.seconds
        return Course(wish, push)

    def told(self, position: Array, velocity: Array, course: Course, k: int, gains: Pair | None = None) -> Array:
        """What the hand takes, `k` periods after the decision, shape (..., n): torques, N·m, or positions, rad."""
        if self.leads and course.wish is not None:
            return np.asarray(course.wish[k, 0])
        return self.torque(position, velocity, course, k, gains)

    def torque(self, position: Array, velocity: Array, course: Course, k: int, gains: Pair | None = None) -> Array:
        """What the motors should do `k` periods after the decision, shape (..., n), N·m. `gains`: others, kp and kd."""
        wish, push = course
        if wish is None:
            assert push is not None
            return push
        own = self._own(position.ndim)
        kp, kd = (own.kp, own.kd) if gains is None else gains
        pull = laws.pd(wish[k, 0] - position, wish[k, 1] - velocity, kp, kd)
        return pull if push is None else pull + push

    def pull(self, position: Array, velocity: Array, course: Course, k: int, gains: Array, out: Array) -> None:
        """As `torque`, to the bit, without new arrays: into one (..., n) that is there, with kp and kd in one
        (2, ..., n). It uses the course's k-th set-points up."""
        wish, push = course
        if wish is None:
            assert push is not None
            out[...] = push
            return
        error = wish[k]  # What is left of the way, and then the two torques.
        way, rate = error[0], error[1]
        np.subtract(way, position, way)
        np.subtract(rate, velocity, rate)
        np.multiply(error, gains, error)
        np.add(way, rate, out)
        if push is not None:
            np.add(out, push, out)

    def elapsed(self, memory: Memory) -> Memory:
        """The memory when the set-points of a decision have run out and the next is due."""
        return memory._replace(tick=memory.tick + self.decimation)

    def observe(
        self, position: Array, velocity: Array, memory: Memory, goal: NDArray[np.floating[Any]] | None = None
    ) -> Observation:
        """What the policy sees, from measured joints (..., n), rad and rad/s. With a goal, a dictionary as goal
        environments have it. docs/rl.md#observations says which number is what."""
        xp, own = self.xp, self._own(position.ndim)
        target = _within(xp, own.base(xp, memory) + memory.end, own.lower, own.upper)
        parts: list[Any] = [position - own.middle, velocity, (target - position) * own.kp, memory.end]
        if self.scripts is not None:
            parts.append(memory.tick[..., None])
        seen = _within(xp, xp.concatenate(parts, axis=-1) / own.scale, -BOUND, BOUND)
        joints = xp.asarray(seen, np.float32)
        if self.history > 1:
            joints = xp.concatenate([joints, memory.past], axis=-1)
        if goal is None:
            return joints  # type: ignore[no-any-return]  # An array of the library's.
        achieved = xp.asarray(self.fingertips(position), np.float32)
        return {"observation": joints, "achieved_goal": achieved, "desired_goal": xp.copy(xp.asarray(goal, np.float32))}

    def fingertips(self, position: Array) -> Array:
        """Fingertips in the palm frame, one after the other in the spec's order, shape (..., 3 * fingers), m."""
        tips = self._fingertips(position)
        flat: Array = tips.reshape(*tips.shape[:-2], -1)
        return flat

    @cached_property
    def _fingertips(self) -> Callable[[Array], Array]:
        return hand_kinematics(self.spec).batch_fingertips(self.xp)


def _within(xp: Any, x: Array, low: Array | float, high: Array | float) -> Array:
    """What `clip` does, without the 5 µs a call of NumPy's."""
    found: Array = xp.minimum(xp.maximum(x, low), high)
    return found
