"""What a policy sees and what its actions mean: one object, used by training and by every hand that a policy drives.

Everything broadcasts over leading batch dimensions `(..., n)`. A row comes out the same, bit for bit, whatever the size
of the batch it stands in.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allegro_twin.control import laws
from allegro_twin.control.controllers import Gains
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.tips import Fingertips
from allegro_twin.policy.memory import Course, Memory
from allegro_twin.policy.script import Scripts
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

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
    """From what a hand reports to an observation, from an action in [-1, 1] to set-points, from those to torque.

    The base is the script's set-point or, without a script, the middle of the joint range. In the mode `delta` an
    action adds `step` times itself to the offset from the base, in `absolute` it is the offset in units of `span`; the
    target travels there in a straight line until the next decision. In `torque` it is a part of the torque limit, on
    top of what holds the script where there is one.
    """

    spec: HandSpec
    gains: Gains
    mode: Mode = "delta"
    period: float = 0.003
    """Control period, s."""
    decimation: int = 13
    """Control periods between two decisions."""
    step: float = 0.1
    """rad a decision, in the mode `delta`."""
    scripts: Scripts | None = None
    reach: float = 0.3
    """With a script: the farthest that a policy may go from it, rad."""
    goal: Literal["none", "fingertips"] = "none"
    """`fingertips`: where they should be in the palm frame, shape (..., 3 * fingers), m."""

    history: int = 1
    """How many decisions an observation shows, this one and those before."""

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise ConfigError(f"control mode {self.mode!r} is none of {', '.join(MODES)}")
        if self.decimation < 1:
            raise ConfigError(f"decimation {self.decimation} must be at least 1 control period a decision")

    @cached_property
    def middle(self) -> Vector:
        return (self.spec.lower + self.spec.upper) / 2

    @cached_property
    def half(self) -> Vector:
        return (self.spec.upper - self.spec.lower) / 2

    @cached_property
    def span(self) -> Vector:
        """The largest offset from the base, shape (n,), rad."""
        return self.half if self.scripts is None else np.full_like(self.half, self.reach)

    @cached_property
    def _rest(self) -> Vector:
        return np.zeros_like(self.middle)

    @cached_property
    def _scale(self) -> Vector:
        """What the numbers of an observation are divided by, (n_observation,)."""
        parts = [self.half, np.full_like(self.half, SPEED), self.spec.actuation.torque_limit * np.ones_like(self.half)]
        return np.concatenate([*parts, self.span, [] if self.scripts is None else [float(self.scripts.periods)]])

    @cached_property
    def _parts(self) -> Vector:
        """How much of the way to the new offset is behind the target, a period each, (decimation,)."""
        return np.arange(1, self.decimation + 1) / self.decimation

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
        shape = position.shape[:-1]
        base = self.middle if self.scripts is None else self.scripts.position[script, 0]
        drawn = (position if self.scripts is None else base) if target is None else target
        offset = np.zeros_like(position) + _within(drawn - base, -self.span, self.span)
        number = np.broadcast_to(np.asarray(script, dtype=np.int64), shape).copy()
        past = np.zeros((*shape, self.frame * (self.history - 1)), np.float32)
        return Memory(offset, offset.copy(), np.zeros_like(position), np.zeros(shape, np.int64), number, past)

    def act(self, action: NDArray[np.floating[Any]], memory: Memory, seen: Floats | None = None) -> Memory:
        """Take a decision: the set-points until the next. `action` in [-1, 1], beyond it clipped, shape (..., n).
        `seen`: the observation that led to it (its goals left out), which those with a history go on showing."""
        wish = _within(action.astype(np.float64), -1.0, 1.0)
        begin, end, push, tick, script, past = memory
        if self.history > 1:
            assert seen is not None
            past = np.concatenate([seen[..., : self.frame], past], axis=-1)[..., : past.shape[-1]]
        match self.mode:
            case "torque":
                return Memory(begin, end, wish * self.spec.actuation.torque_limit, tick, script, past)
            case "delta":
                return Memory(end, _within(end + self.step * wish, -self.span, self.span), push, tick, script, past)
            case _:
                return Memory(end, wish * self.span, push, tick, script, past)

    def course(self, memory: Memory) -> Course:
        """The set-points from a decision to the next."""
        push = memory.push if self.mode == "torque" else None
        if push is not None and self.scripts is None:
            return Course(None, push)
        base, speed = self._base(memory, np.arange(self.decimation).reshape(-1, *(1,) * memory.tick.ndim))
        travel = memory.end - memory.begin
        wish = np.empty((self.decimation, 2, *travel.shape))
        target = wish[:, 0]
        np.multiply(travel, self._parts.reshape(-1, *(1,) * travel.ndim), out=target)
        np.add(target, memory.begin, out=target)
        np.add(target, base, out=target)
        np.maximum(target, self.spec.lower, out=target)
        np.minimum(target, self.spec.upper, out=target)
        np.add(speed, travel / self.seconds, out=wish[:, 1])
        return Course(wish, push)

    def torque(self, position: Array, velocity: Array, course: Course, k: int, gains: Pair | None = None) -> Array:
        """What the motors should do `k` periods after the decision, shape (..., n), N·m. `gains`: others, kp and kd."""
        wish, push = course
        if wish is None:
            assert push is not None
            return push
        kp, kd = (self.gains.kp, self.gains.kd) if gains is None else gains
        pull = laws.pd(wish[k, 0] - position, wish[k, 1] - velocity, kp, kd)
        return pull if push is None else pull + push

    def pull(self, motion: Array, course: Course, k: int, gains: Array, out: Array) -> None:
        """As `torque`, to the bit, in three operations and into an array (..., n) that is there: positions and speeds
        are one array (2, ..., n), as kp and kd are. It uses the course's k-th set-points up."""
        wish, push = course
        if wish is None:
            assert push is not None
            out[...] = push
            return
        error = wish[k]  # What is left of the way, and then the two torques.
        np.subtract(error, motion, out=error)
        np.multiply(error, gains, out=error)
        np.add(error[0], error[1], out=out)
        if push is not None:
            np.add(out, push, out=out)

    def elapsed(self, memory: Memory) -> Memory:
        """The memory when the set-points of a decision have run out and the next is due."""
        return memory._replace(tick=memory.tick + self.decimation)

    def observe(
        self, position: Array, velocity: Array, memory: Memory, goal: NDArray[np.floating[Any]] | None = None
    ) -> Observation:
        """What the policy sees, from measured joints (..., n), rad and rad/s. With a goal, a dictionary as goal
        environments have it. docs/rl.md#observations says which number is what."""
        n = self.spec.n_joints
        seen = np.empty((*position.shape[:-1], self.frame))
        np.subtract(position, self.middle, out=seen[..., :n])
        seen[..., n : 2 * n] = velocity
        lead = seen[..., 2 * n : 3 * n]
        np.add(self._base_now(memory), memory.end, out=lead)
        np.maximum(lead, self.spec.lower, out=lead)
        np.minimum(lead, self.spec.upper, out=lead)
        np.subtract(lead, position, out=lead)
        np.multiply(lead, self.gains.kp, out=lead)
        seen[..., 3 * n : 4 * n] = memory.end
        if self.scripts is not None:
            seen[..., -1] = memory.tick
        np.divide(seen, self._scale, out=seen)
        np.maximum(seen, -BOUND, out=seen)
        np.minimum(seen, BOUND, out=seen)
        joints = seen.astype(np.float32)
        if self.history > 1:
            joints = np.concatenate([joints, memory.past], axis=-1)
        if goal is None:
            return joints
        achieved = self.fingertips(position).astype(np.float32)
        return {"observation": joints, "achieved_goal": achieved, "desired_goal": goal.astype(np.float32)}

    def fingertips(self, position: Array) -> Array:
        """Fingertips in the palm frame, one after the other in the spec's order, shape (..., 3 * fingers), m."""
        tips = self._fingertips(position)
        return tips.reshape(*tips.shape[:-2], -1)

    @cached_property
    def _fingertips(self) -> Fingertips:
        return Fingertips(self.spec)

    def _base(self, memory: Memory, k: NDArray[np.int64]) -> Pair:
        """What offsets are counted from, and its rate, `k` periods after the decision."""
        if self.scripts is None:
            return self.middle, self._rest
        row = np.minimum(memory.tick + k, self.scripts.periods - 1)
        return self.scripts.position[memory.script, row], self.scripts.velocity[memory.script, row]

    def _base_now(self, memory: Memory) -> Array:
        if self.scripts is None:
            return self.middle
        return self.scripts.position[memory.script, np.minimum(memory.tick, self.scripts.periods - 1)]


def _within(x: Array, low: Array | float, high: Array | float) -> Array:
    """What `np.clip` does, without its 5 µs a call."""
    return np.asarray(np.minimum(np.maximum(x, low), high))
