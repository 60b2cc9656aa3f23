"""What a policy sees and what its actions mean: one object, used by training and by every hand that a policy drives.

Everything broadcasts over leading batch dimensions `(..., n)`. A row comes out the same, bit for bit, whatever the size
of the batch it stands in.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allegro_twin.control import laws
from allegro_twin.control.controllers import Gains
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.closed_form import FingerKinematics
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


class Course(NamedTuple):
    """Set-points of every control period from one decision to the next."""

    target: Array | None
    """Shape (decimation, ..., n), rad; None: torque alone."""
    rate: Array | None
    """Shape (decimation, ..., n), rad/s."""
    push: Array | None
    """Torque on top, shape (..., n), N·m."""


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

    @property
    def n_observation(self) -> int:
        return 4 * self.spec.n_joints + (0 if self.scripts is None else 1)

    @property
    def n_goal(self) -> int:
        return 0 if self.goal == "none" else 3 * len(self.spec.fingers)

    @property
    def seconds(self) -> float:
        """Between two decisions."""
        return self.period * self.decimation

    def start(self, position: Array, script: NDArray[np.int64] | int = 0) -> Memory:
        """The memory with which to meet the first state; `position` as measured, shape (..., n), rad."""
        shape = position.shape[:-1]
        offset = np.zeros_like(position) if self.scripts is not None else position - self.middle
        number = np.broadcast_to(np.asarray(script, dtype=np.int64), shape).copy()
        return Memory(offset, offset.copy(), np.zeros_like(position), np.zeros(shape, np.int64), number)

    def act(self, action: NDArray[np.floating[Any]], memory: Memory) -> Memory:
        """Take a decision: the set-points until the next. `action` in [-1, 1], beyond it clipped, shape (..., n)."""
        wish = _within(action.astype(np.float64), -1.0, 1.0)
        if self.mode == "torque":
            return memory._replace(push=wish * self.spec.actuation.torque_limit)
        end = wish * self.span
        if self.mode == "delta":
            end = _within(memory.end + self.step * wish, -self.span, self.span)
        return memory._replace(begin=memory.end, end=end)

    def course(self, memory: Memory) -> Course:
        """The set-points from a decision to the next."""
        if self.mode == "torque" and self.scripts is None:
            return Course(None, None, memory.push)
        k = np.arange(self.decimation).reshape(-1, *(1,) * memory.tick.ndim)
        base, speed = self._base(memory, k)
        travel = memory.end - memory.begin
        part = ((k + 1) / self.decimation)[..., None]
        target = _within(base + (memory.begin + travel * part), self.spec.lower, self.spec.upper)
        rate = np.broadcast_to(speed + travel / self.seconds, target.shape)
        return Course(target, rate, memory.push if self.mode == "torque" else None)

    def torque(self, position: Array, velocity: Array, course: Course, k: int, gains: Pair | None = None) -> Array:
        """What the motors should do `k` periods after the decision, shape (..., n), N·m. `gains`: others, kp and kd."""
        target, rate, push = course
        if target is None or rate is None:
            assert push is not None
            return push
        kp, kd = (self.gains.kp, self.gains.kd) if gains is None else gains
        pull = laws.pd(target[k] - position, rate[k] - velocity, kp, kd)
        return pull if push is None else pull + push

    def elapsed(self, memory: Memory) -> Memory:
        """The memory when the set-points of a decision have run out and the next is due."""
        return memory._replace(tick=memory.tick + self.decimation)

    def observe(
        self, position: Array, velocity: Array, memory: Memory, goal: NDArray[np.floating[Any]] | None = None
    ) -> Observation:
        """What the policy sees, from measured joints (..., n), rad and rad/s. With a goal, a dictionary as goal
        environments have it. docs/rl.md#observations says which number is what."""
        base, _ = self._base(memory, 0)
        target = _within(base + memory.end, self.spec.lower, self.spec.upper)
        parts = [
            (position - self.middle) / self.half,
            velocity / SPEED,
            self.gains.kp * (target - position) / self.spec.actuation.torque_limit,
            memory.end / self.span,
        ]
        if self.scripts is not None:
            parts.append((memory.tick / self.scripts.periods)[..., None])
        joints = _within(np.concatenate(parts, axis=-1), -BOUND, BOUND).astype(np.float32)
        if goal is None:
            return joints
        achieved = self.fingertips(position).astype(np.float32)
        return {"observation": joints, "achieved_goal": achieved, "desired_goal": goal.astype(np.float32)}

    def fingertips(self, position: Array) -> Array:
        """Fingertips in the palm frame, one after the other in the spec's order, shape (..., 3 * fingers), m."""
        # One row at a time as far as matrix products are concerned: BLAS rounds differently for different shapes.
        rows = np.ascontiguousarray(position)[..., None, :]
        tips = [finger.tip(rows[..., joints])[..., 0, :] for finger, joints in self._fingers]
        return np.concatenate(tips, axis=-1)

    @cached_property
    def _fingers(self) -> list[tuple[FingerKinematics, list[int]]]:
        return [(FingerKinematics(self.spec, finger.name), list(finger.joints)) for finger in self.spec.fingers]

    def _base(self, memory: Memory, k: NDArray[np.int64] | int) -> tuple[Array, Array]:
        if self.scripts is None:
            return self.middle, self._rest
        row = np.minimum(memory.tick + k, self.scripts.periods - 1)
        return self.scripts.position[memory.script, row], self.scripts.velocity[memory.script, row]


def _within(x: Array, low: Array | float, high: Array | float) -> Array:
    """What `np.clip` does, without its 5 µs a call."""
    bounded: Array = np.minimum(np.maximum(x, low), high)
    return bounded
