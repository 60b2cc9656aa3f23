"""Interface of a policy: observations of a hand, and the meaning of actions. Training and every hand use the same
object.

Everything broadcasts over leading batch dimensions `(..., n)`. A row's result is the same, bit for bit, for any size of
its batch.
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
from allegro_twin.learning.policy.script import ScriptTable
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

VERSION = 1
"""Version of the meaning of observations and actions. A policy of another version is refused."""
MODES = ("delta", "absolute", "torque")
Mode: TypeAlias = Literal["delta", "absolute", "torque"]
Floats: TypeAlias = NDArray[np.float32]
Observation: TypeAlias = Floats | dict[str, Floats]
Goal: TypeAlias = NDArray[np.floating[Any]]
Pair: TypeAlias = tuple[Array, Array]
BOUND = 5.0
"""Bound of every number in an observation: clipped to ±5, since a space must be finite."""
# rad/s; half the hand's no-load speed (docs/reference/allegro_model.md#actuation): usual speeds are of order 1.
SPEED = 5.0


class InterfaceMemory(NamedTuple):
    """Memory between two decisions."""

    begin: Array
    """Offset from the base at the last decision, shape (..., n), rad."""
    end: Array
    """Offset to be reached at the next decision, shape (..., n), rad."""
    push: Array
    """Torque of the running action, shape (..., n), N·m; only in the mode `torque`."""
    tick: NDArray[np.int64]
    """Control periods from the beginning to the last decision, shape (...)."""
    script: NDArray[np.int64]
    """Number of the script, shape (...)."""
    past: NDArray[np.float32]
    """Earlier observations, the last one first; zeros where there were none. Shape (..., k)."""


class DecisionSetPoints(NamedTuple):
    """Set-points of every control period from one decision to the next."""

    targets: Array | None
    """Targets, rad, and their rates, rad/s: shape (decimation, 2, ..., n); None: torque alone."""
    torque: Array | None
    """Additional torque, shape (..., n), N·m."""


class InterfaceConstants(NamedTuple):
    """Constants of the interface. Shape (n,) unless noted, or (1, …, n) from `ConstantsByRank`."""

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
    """Scale of an observation's numbers, (frame,)."""
    parts: Vector
    """Share of the way to the new offset that is done, one per period, (decimation,)."""
    periods: NDArray[np.int64]
    """Numbers of these periods, from 0, (decimation,)."""
    scripts: tuple[Array, Array] | None
    """Set-points and their rates, one script after the other, (s * t, n)."""
    length: int
    """Periods of a script, t."""

    def base(self, xp: Any, memory: InterfaceMemory) -> Array:
        """Base of the offsets at a decision, (..., n)."""
        return self.middle if self.scripts is None else take(self.scripts[0], self._row(xp, memory, 0), 0)

    def bases(self, xp: Any, memory: InterfaceMemory) -> tuple[Array, Array]:
        """Bases of all periods until the next decision, with their rates, (decimation, ..., n) or (..., n) each."""
        if self.scripts is None:
            return self.middle, self.rest
        row = self._row(xp, memory, self.periods)
        return take(self.scripts[0], row, 0), take(self.scripts[1], row, 0)

    def _row(self, xp: Any, memory: InterfaceMemory, later: NDArray[np.int64] | int) -> Any:
        """Row of a period in the table of scripts; the last set-points stay."""
        return memory.script * self.length + xp.minimum(memory.tick + later, self.length - 1)


_OF_JOINTS = ("step", "middle", "rest", "lower", "upper", "span", "kp", "kd", "limit", "scale")


class ConstantsByRank:
    """The constants with as many dimensions as the arrays they are combined with: NumPy adds arrays of the same shape
    in a third of the time."""

    def __init__(self, numbers: InterfaceConstants) -> None:
        self._flat = numbers
        self._known: dict[int, InterfaceConstants] = {}

    def __call__(self, ndim: int) -> InterfaceConstants:
        if ndim not in self._known:
            flat, ones = self._flat, (1,) * (ndim - 1)
            wide = {name: getattr(flat, name).reshape(*ones, -1) for name in _OF_JOINTS}
            parts, periods = flat.parts.reshape(-1, *ones, 1), flat.periods.reshape(-1, *ones)
            self._known[ndim] = InterfaceConstants(
                **wide, parts=parts, periods=periods, scripts=flat.scripts, length=flat.length
            )
        return self._known[ndim]


def observation_frame(joints: int, script: bool) -> int:
    """Numbers of one decision in an observation, with the time of a script or without."""
    return 4 * joints + int(script)


def radian_scale(spec: HandSpec) -> Vector:
    """A radian of a joint in its motor's positions, (n,): 1. Where motors move joints through tendons or linkages: the
    share of the motor's range that a radian is of a quarter turn."""
    span = spec.upper - spec.lower
    return span / (np.pi / 2) if spec.followers else np.ones_like(span)


def make_constants(
    spec: HandSpec,
    gains: Gains,
    sizes: tuple[Vector, Vector, Vector, Vector],
    decimation: int,
    scripts: ScriptTable | None,
    xp: Any,
) -> InterfaceConstants:
    """`sizes`: half the range, the scale of a speed, the largest offset and the step of a decision, (n,) each."""
    half, speed, span, step = sizes
    limit = spec.actuation.torque_limit
    scale = np.concatenate([half, speed, limit, span, [] if scripts is None else [float(scripts.periods)]])
    place, middle = xp.asarray, (spec.lower + spec.upper) / 2
    return InterfaceConstants(
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
        scripts=None if scripts is None else _script_rows(scripts, place),
        length=0 if scripts is None else scripts.periods,
    )


def _script_rows(scripts: ScriptTable, place: Callable[[Array], Array]) -> tuple[Array, Array]:
    joints = scripts.position.shape[-1]
    return place(scripts.position.reshape(-1, joints)), place(scripts.velocity.reshape(-1, joints))


@dataclass(frozen=True, eq=False)
class Interface:
    """Converts a hand's reports to observations, actions in [-1, 1] to set-points, and set-points to commands.

    The base is the script's set-point or, without a script, the middle of the joint range. In the mode `delta` an
    action adds `step` times itself to the offset from the base; in `absolute` it is the offset in units of `span`. The
    target moves there in a straight line until the next decision. In `torque` an action is a share of the torque limit,
    added to the torque that holds the script, if there is one. A hand that closes its own loop gets the set-points
    themselves.
    """

    spec: HandSpec
    gains: Gains
    mode: Mode = "delta"
    period: float = 0.003
    """Control period, s."""
    decimation: int = 13
    """Control periods between two decisions."""
    step: float = 0.1
    """rad per decision, in the mode `delta`; in the units of `radian_scale`."""
    scripts: ScriptTable | None = None
    reach: float = 0.3
    """With a script: largest distance from it, rad, likewise."""
    goal: Literal["none", "fingertips"] = "none"
    """`fingertips`: goals are fingertip positions in the palm frame, shape (..., 3 * fingers), m."""

    history: int = 1
    """Decisions in an observation: this one and those before."""
    xp: Any = np
    """Array library: `numpy`, or `array_api.TensorNamespace`; then every array here is a tensor."""

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise ConfigError(f"control mode {self.mode!r} is none of {', '.join(MODES)}")
        if self.mode == "torque" and self.takes_positions:
            raise ConfigError(
                f"{self.spec.name} closes its own loop and takes no torques: control is delta or absolute"
            )
        if self.decimation < 1:
            raise ConfigError(f"decimation {self.decimation} must be at least 1 control period a decision")

    @property
    def takes_positions(self) -> bool:
        """Whether the hand closes its own loop and takes positions."""
        return "torque" not in self.spec.commands

    @cached_property
    def middle(self) -> Vector:
        return (self.spec.lower + self.spec.upper) / 2

    @cached_property
    def half(self) -> Vector:
        return (self.spec.upper - self.spec.lower) / 2

    @cached_property
    def span(self) -> Vector:
        """Largest offset from the base, shape (n,), rad."""
        return self.half if self.scripts is None else self.reach * radian_scale(self.spec)

    @cached_property
    def _constants(self) -> ConstantsByRank:
        """Constants on the arrays' device, by number of dimensions."""
        unit = radian_scale(self.spec)
        sizes = self.half, SPEED * unit, self.span, self.step * unit
        return ConstantsByRank(make_constants(self.spec, self.gains, sizes, self.decimation, self.scripts, self.xp))

    @property
    def frame(self) -> int:
        """Numbers of one decision in an observation."""
        return observation_frame(self.spec.n_joints, self.scripts is not None)

    @property
    def n_observation(self) -> int:
        return self.frame * self.history

    @property
    def n_goal(self) -> int:
        return 0 if self.goal == "none" else 3 * len(self.spec.fingers)

    @property
    def seconds(self) -> float:
        """Time between two decisions."""
        return self.period * self.decimation

    def start(
        self, position: Array, script: NDArray[np.int64] | int = 0, target: Array | None = None
    ) -> InterfaceMemory:
        """Memory for the first state; `position` as measured, shape (..., n), rad. `target`: initial set-points; None:
        the script's beginning, or without a script where the joints are."""
        own, xp, shape = self._constants(position.ndim), self.xp, position.shape[:-1]
        base = own.middle if own.scripts is None else own.scripts[0][script * own.length]
        drawn = (position if own.scripts is None else base) if target is None else target
        offset = xp.zeros(position.shape) + _clip(xp, drawn - base, -own.span, own.span)
        number = xp.zeros(shape, np.int64) + xp.asarray(script, np.int64)
        past = xp.zeros((*shape, self.frame * (self.history - 1)), np.float32)
        return InterfaceMemory(
            offset, xp.copy(offset), xp.zeros(position.shape), xp.zeros(shape, np.int64), number, past
        )

    def act(
        self, action: NDArray[np.floating[Any]], memory: InterfaceMemory, observation: Floats | None = None
    ) -> InterfaceMemory:
        """Take a decision: returns the memory until the next. `action` is clipped to [-1, 1], shape (..., n).
        `observation`: of this decision, without goals; needed with a history."""
        xp, own = self.xp, self._constants(memory.end.ndim)
        clipped = _clip(xp, xp.asarray(action, np.float64), -1.0, 1.0)
        begin, end, push, tick, script, past = memory
        if self.history > 1:
            assert observation is not None
            past = xp.concatenate([observation[..., : self.frame], past], axis=-1)[..., : past.shape[-1]]
        match self.mode:
            case "torque":
                return InterfaceMemory(begin, end, clipped * own.limit, tick, script, past)
            case "delta":
                return InterfaceMemory(
                    end, _clip(xp, end + own.step * clipped, -own.span, own.span), push, tick, script, past
                )
            case _:
                return InterfaceMemory(end, clipped * own.span, push, tick, script, past)

    def set_points(self, memory: InterfaceMemory) -> DecisionSetPoints:
        """The set-points from a decision to the next."""
        push = memory.push if self.mode == "torque" else None
        if push is not None and self.scripts is None:
            return DecisionSetPoints(None, push)
        xp, own = self.xp, self._constants(memory.end.ndim)
        base, speed = own.bases(xp, memory)
        travel = memory.end - memory.begin
        targets = xp.zeros((self.decimation, 2, *travel.shape))
        targets[:, 0] = _clip(xp, own.parts * travel + memory.begin + base, own.lower, own.upper)
        targets[:, 1] = speed + travel / self.seconds
        return DecisionSetPoints(targets, push)

    def command(
        self, position: Array, velocity: Array, set_points: DecisionSetPoints, k: int, gains: Pair | None = None
    ) -> Array:
        """The hand's command `k` periods after the decision, shape (..., n): torques, N·m, or positions, rad."""
        if self.takes_positions and set_points.targets is not None:
            return np.asarray(set_points.targets[k, 0])
        return self.torque(position, velocity, set_points, k, gains)

    def torque(
        self, position: Array, velocity: Array, set_points: DecisionSetPoints, k: int, gains: Pair | None = None
    ) -> Array:
        """Motor torques `k` periods after the decision, shape (..., n), N·m. `gains`: other kp and kd."""
        targets, push = set_points
        if targets is None:
            assert push is not None
            return push
        own = self._constants(position.ndim)
        kp, kd = (own.kp, own.kd) if gains is None else gains
        pull = laws.pd(targets[k, 0] - position, targets[k, 1] - velocity, kp, kd)
        return pull if push is None else pull + push

    def pd_torque_into(
        self, position: Array, velocity: Array, set_points: DecisionSetPoints, k: int, gains: Array, out: Array
    ) -> None:
        """As `torque`, to the bit, without new arrays: into `out` (..., n), with kp and kd in one array (2, ..., n). It
        overwrites the k-th set-points."""
        targets, push = set_points
        if targets is None:
            assert push is not None
            out[...] = push
            return
        error = targets[k]  # The error, and then the two torques.
        position_error, velocity_error = error[0], error[1]
        np.subtract(position_error, position, position_error)
        np.subtract(velocity_error, velocity, velocity_error)
        np.multiply(error, gains, error)
        np.add(position_error, velocity_error, out)
        if push is not None:
            np.add(out, push, out)

    def advance(self, memory: InterfaceMemory) -> InterfaceMemory:
        """The memory after the set-points of a decision have run out, for the next one."""
        return memory._replace(tick=memory.tick + self.decimation)

    def observe(
        self, position: Array, velocity: Array, memory: InterfaceMemory, goal: NDArray[np.floating[Any]] | None = None
    ) -> Observation:
        """Observation from measured joints (..., n), rad and rad/s. With a goal, a dictionary as in goal environments.
        docs/reference/environments.md#observations describes each number."""
        xp, own = self.xp, self._constants(position.ndim)
        target = _clip(xp, own.base(xp, memory) + memory.end, own.lower, own.upper)
        parts: list[Any] = [position - own.middle, velocity, (target - position) * own.kp, memory.end]
        if self.scripts is not None:
            parts.append(memory.tick[..., None])
        clipped = _clip(xp, xp.concatenate(parts, axis=-1) / own.scale, -BOUND, BOUND)
        joints = xp.asarray(clipped, np.float32)
        if self.history > 1:
            joints = xp.concatenate([joints, memory.past], axis=-1)
        if goal is None:
            return joints  # type: ignore[no-any-return]  # An array of the library's.
        achieved = xp.asarray(self.fingertips(position), np.float32)
        return {"observation": joints, "achieved_goal": achieved, "desired_goal": xp.copy(xp.asarray(goal, np.float32))}

    def fingertips(self, position: Array) -> Array:
        """Fingertips in the palm frame, in the spec's order, shape (..., 3 * fingers), m."""
        tips = self._fingertips(position)
        flat: Array = tips.reshape(*tips.shape[:-2], -1)
        return flat

    @cached_property
    def _fingertips(self) -> Callable[[Array], Array]:
        return hand_kinematics(self.spec).batch_fingertips(self.xp)


def _clip(xp: Any, x: Array, low: Array | float, high: Array | float) -> Array:
    """As `clip`, without NumPy's 5 µs per call."""
    found: Array = xp.minimum(xp.maximum(x, low), high)
    return found
