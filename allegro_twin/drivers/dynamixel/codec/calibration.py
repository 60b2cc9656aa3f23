"""Calibration between a servo's shaft and the actuator that it drives, the same at both ends of the wire."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from allegro_twin.drivers.dynamixel.codec.packet import LAST_ID
from allegro_twin.drivers.dynamixel.codec.table import FARTHEST, TURN, Model
from allegro_twin.errors import ConfigError
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector, frozen

RAD_PER_TICK = 2.0 * np.pi / TURN
HALFWAY = TURN / 2.0
_MOST = 16_383  # That a gain can be.


@dataclass(frozen=True)
class Mounting:
    """Mounting of one servo on its actuator: zero, direction, gear. Raises ConfigError for what cannot be."""

    id: int
    current_limit: float
    """The most that it may draw, A. There is no default: a hand is known by it."""
    zero: float = HALFWAY
    """Tick at which the actuator's position is 0."""
    direction: int = 1
    """+1 where a higher tick is a higher position, else -1."""
    gear: float = 1.0
    """What the actuator's position changes by in a radian of the shaft: 1 for a joint on the shaft itself, rad."""
    torque_per_ampere: float | None = None
    """At the shaft, N·m/A; None: of the data sheet's stall."""
    gains: tuple[int, int, int] | None = None
    """Position P, I and D as they stand in the servo; None: those that its mode brings."""

    def __post_init__(self) -> None:
        for name, right, rule in (
            ("id", 0 <= self.id <= LAST_ID, f"from 0 to {LAST_ID}"),
            ("current_limit", 0.0 < self.current_limit < np.inf, "above 0, in A"),
            ("zero", -FARTHEST <= self.zero <= FARTHEST, f"within ±{FARTHEST} ticks"),
            ("direction", self.direction in (1, -1), "1 or -1"),
            ("gear", 0.0 < self.gear < np.inf, "above 0"),
            ("gains", all(0 <= gain <= _MOST for gain in self.gains or ()), f"from 0 to {_MOST}"),
            ("torque_per_ampere", self.torque_per_ampere is None or 0.0 < self.torque_per_ampere < np.inf, "above 0"),
        ):
            if not right:
                raise ConfigError(f"servo {self.id}: {name} must be {rule}, not {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class Calibration:
    """All servos of a hand, in the order of its actuators. Raises ConfigError for ids that are there twice, and for a
    current limit that the model does not have."""

    model: Model
    servos: tuple[Mounting, ...]

    def __post_init__(self) -> None:
        for servo in self.servos:
            if self.ids.count(servo.id) > 1:
                raise ConfigError(f"two servos of this hand have the id {servo.id}; give each its own")
        highest = self.model.named["current_limit"].high * self.model.current_unit
        for servo, counts in zip(self.servos, self.current_counts, strict=True):
            if servo.current_limit > highest + 0.5 * self.model.current_unit:
                most = f"a {self.model.name} can be given {highest:.3f} A at most"
                raise ConfigError(f"servo {servo.id}: current_limit is {servo.current_limit:g} A; {most}")
            if counts < 1:
                raise ConfigError(f"servo {servo.id}: current_limit of {servo.current_limit:g} A is less than a count")

    def check(self, spec: HandSpec) -> None:
        """Raises ConfigError where these are not the servos of such a hand."""
        if len(self.servos) != spec.n_actuators:
            raise ConfigError(f"{spec.name} has {spec.n_actuators} actuators; {len(self.servos)} servos are described")
        if "limited_position" not in spec.commands:
            kinds = ", ".join(spec.commands)
            raise ConfigError(f"servos need a hand that takes a limited_position; {spec.name} takes {kinds}")

    def names(self, labels: Sequence[str]) -> dict[int, str]:
        """What each id is called in messages: as its joint, where there is one for each."""
        same = len(labels) == len(self.servos)
        return {i: labels[k] if same else f"actuator {k}" for k, i in enumerate(self.ids)}

    def described(self) -> dict[str, Any]:
        """As plain data, for recordings."""
        return {"model": self.model.name, "servos": [vars(servo) for servo in self.servos]}

    @cached_property
    def ids(self) -> tuple[int, ...]:
        return tuple(servo.id for servo in self.servos)

    @cached_property
    def _per_tick(self) -> Vector:
        return frozen([servo.direction * servo.gear * RAD_PER_TICK for servo in self.servos])

    @cached_property
    def _zero(self) -> Vector:
        return frozen([servo.zero for servo in self.servos])

    @cached_property
    def _per_velocity(self) -> Vector:
        return frozen(self._per_tick * (self.model.velocity_unit / RAD_PER_TICK))

    @cached_property
    def _per_current(self) -> Vector:
        """Torque at the actuator, with its sign, N·m a count."""
        unit, own = self.model.current_unit, self.model.torque_per_ampere
        return frozen([unit * s.direction * (s.torque_per_ampere or own) / s.gear for s in self.servos])

    @cached_property
    def current_counts(self) -> tuple[int, ...]:
        """The most that each may draw, in counts, rounded down."""
        unit = self.model.current_unit
        return tuple(int(servo.current_limit / unit + 1e-6) for servo in self.servos)

    def ticks(self, position: Vector) -> list[int]:
        """Nearest ticks for positions of the actuators, shape (m,), rad; no farther than the servos count."""
        ticks = np.rint(position / self._per_tick + self._zero)
        return _whole(np.minimum(np.maximum(ticks, -FARTHEST), FARTHEST))

    def position(self, ticks: Array) -> Vector:
        """Positions of the actuators, shape (m,), rad, from ticks."""
        return (ticks - self._zero) * self._per_tick

    def velocity(self, counts: Array) -> Vector:
        """Velocities of the actuators, shape (m,), rad/s, from counts."""
        return counts * self._per_velocity

    def velocity_counts(self, velocity: Vector) -> Array:
        return np.rint(velocity / self._per_velocity)

    def torque(self, counts: Array) -> Vector:
        """Torques of the actuators, with sign, shape (m,), N·m, from counts."""
        return counts * self._per_current

    def torque_counts(self, torque: Vector) -> Array:
        return np.rint(torque / self._per_current)

    def effort(self, counts: Array) -> Vector:
        """What a current without sign can do at the actuators, shape (m,), N·m."""
        return np.abs(self.torque(np.abs(counts)))

    def effort_counts(self, effort: Vector) -> list[int]:
        """The current to allow for an effort, in counts, rounded down, and never above the limit."""
        counts = np.floor(effort / np.abs(self._per_current) + 1e-6)
        return _whole(np.minimum(counts, self.current_counts))


def _whole(values: Array) -> list[int]:
    found: list[int] = values.astype(int).tolist()
    return found
