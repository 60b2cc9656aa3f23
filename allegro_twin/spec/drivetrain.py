"""Drivetrain from a commanded torque to a joint: delay, strength, friction, backlash, encoders, faults."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, Self, TypeAlias

import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.types import Vector, frozen


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """The drive of one hand. Arrays have a value per joint, shape (n,); the defaults change nothing."""

    delay: float
    """Delay from a command to its torque, s. A recording shows only its sum with the delay of the sensors."""
    strength: Vector
    """Share of a commanded torque that the motors give."""
    stiction: Vector
    """Breakaway friction over dry friction in motion, F_s/F_c, at least 1."""
    stribeck_speed: Vector
    """rad/s over which the one falls to the other."""
    bristle: Vector
    """Presliding displacement before a joint breaks away, rad (LuGre); 0: none, and friction is Coulomb's."""
    load_friction: Vector
    """Dry friction that a motor's torque adds, as a share of it."""
    backlash: Vector
    """How far a link moves freely between its motor's teeth, rad, both ways together. The encoder sees the link."""
    gear_compliance: Vector
    """By how much the teeth behind that bend, rad/(N·m); 0: not at all. Only where there is backlash."""
    encoder_noise: Vector
    """Standard deviation of a reported joint position, rad."""
    encoder_offset: Vector
    """Error of a reported position, rad, after the hand's calibration."""
    quantisation: Vector
    """Step of a reported position, rad; 0: none."""
    mass_scale: Vector
    """Factor on the mass and inertia of the link that each joint moves."""
    bias_torque: Vector
    """Constant torque on the joint, N·m: a cable's, and half of what dry friction differs by between directions."""
    stiffness: Vector
    """Torque against the joint's angle, N·m/rad: a spring's, or a cable's that is bent. With `bias_torque` it rests at
    bias_torque / stiffness."""
    uneven_damping: Vector
    """Half the difference of forward and backward damping, N·m·s/rad: larger forwards."""
    cogging_cosine: Vector
    """Cosine part of the cogging torque, N·m: the factor of cos(N q), N being `cogging_periods`."""
    cogging_sine: Vector
    """Sine part of the cogging torque, N·m: the factor of sin(N q)."""
    cogging_periods: Vector
    """Periods N of cogging in a turn; 0: none."""
    ripple_cosine: Vector
    """Cosine part of torque ripple, as a share of the motor's torque: the factor of cos(N q), N being
    `ripple_periods`."""
    ripple_sine: Vector
    """Sine part of torque ripple, as a share of the motor's torque: the factor of sin(N q)."""
    ripple_periods: Vector
    """Periods N of torque ripple in a turn; 0: none."""
    cold_friction: Vector
    """Share by which friction and damping are larger when the motors are switched on."""
    warm_up: Vector
    """Time constant in which `cold_friction` falls, s; 0: no such friction."""
    tip_mass: Vector
    """Mass of a weight at the fingertip, kg: at the last joint of a finger; 0 elsewhere."""
    tilt: Vector
    """Lean of the palm from the stated gravity: rotation vector of gravity in the palm's frame, (3,), rad."""
    seed: int = 0
    """Seed of the noise."""

    @classmethod
    def from_values(cls, given: Mapping[str, Any], n: int) -> Self:
        """A drive from plain values, one number or `n` each. The message of a ConfigError follows the block's name."""
        names = [field.name for field in fields(cls)]
        for key in given:
            if key not in names:
                raise ConfigError(f": {unknown('key', str(key), names)}")
        rows = {
            name: _row(name, given.get(name, _NOMINAL[name]), _THREE.get(name, n))
            for name in names
            if name not in _SINGLE
        }
        single = {name: _number(name, given.get(name, 0)) for name in _SINGLE}
        if single["seed"] < 0 or single["seed"] % 1:
            raise ConfigError(f".seed is {single['seed']:g}; a seed is a whole number from 0 on")
        if single["delay"] > LONGEST_DELAY:
            raise ConfigError(
                f".delay is {single['delay']:g} s, longer than any hand's ({LONGEST_DELAY:g} s): "
                "it is in s, 3 ms are 0.003"
            )
        return cls(delay=single["delay"], seed=int(single["seed"]), **rows)

    @property
    def parasitic(self) -> bool:
        """Whether a joint feels torque that its motor was not told to give and that is not even friction."""
        rows = (self.bias_torque, self.stiffness, self.uneven_damping, self.cogging_cosine, self.cogging_sine)
        return any(row.any() for row in (*rows, self.ripple_cosine, self.ripple_sine))

    @property
    def warming(self) -> bool:
        """Whether friction of a joint changes while the hand warms up."""
        return bool((self.cold_friction * self.warm_up).any())

    def plain(self) -> dict[str, Any]:
        """Plain values, as `from_values` takes them."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}


Ailment: TypeAlias = Literal[
    "weak", "stuck", "encoder_step", "encoder_drift", "payload", "friction", "slippery", "loose"
]  # fmt: skip
"""Faults of a hand itself."""
AILMENTS: dict[Ailment, tuple[float, float]] = {
    "weak": (0.3, 0.8), "stuck": (1.0, 1.0), "encoder_step": (0.02, 0.1), "encoder_drift": (5e-4, 2e-3),
    "payload": (0.005, 0.03), "friction": (0.02, 0.06), "slippery": (0.05, 0.3),
    "loose": (0.02, 0.08),
}  # fmt: skip
"""How much, when it is drawn by chance: the share that a motor gives; N·m that hold a joint; rad; rad/s; kg at the link
that the joint moves; N·m; the share that is left of the friction of every contact, whatever the joint;
rad of backlash, of a fingertip."""
POSSIBLE: dict[Ailment, tuple[float, float]] = {
    "weak": (0.0, 1.0), "stuck": (0.0, math.inf), "encoder_step": (-math.inf, math.inf),
    "encoder_drift": (-math.inf, math.inf), "payload": (0.0, math.inf), "friction": (0.0, math.inf),
    "slippery": (0.0, 1.0), "loose": (0.0, math.inf),
}  # fmt: skip
"""Least and most amount that there is of each, in the units of `AILMENTS`."""
LONGEST_DELAY = 0.5
"""s from a command to its torque: a hundred times that of the hands we know, so that a longer one is another unit."""
_SINGLE = ("delay", "seed")
_NOMINAL = dict.fromkeys((field.name for field in fields(Drive)), 0.0) | {
    "strength": 1.0, "stiction": 1.0, "mass_scale": 1.0, "stribeck_speed": 0.1,
}  # fmt: skip
_SIGNED = (
    "encoder_offset", "bias_torque", "stiffness", "uneven_damping", "cogging_cosine", "cogging_sine", "ripple_cosine",
    "ripple_sine", "cold_friction", "tilt",
)  # fmt: skip
_LEAST = {"stiction": 1.0} | dict.fromkeys(_SIGNED, -math.inf)
_THREE = {"tilt": 3}
_POSITIVE = ("strength", "stribeck_speed", "mass_scale")


def _row(name: str, given: object, n: int) -> Vector:
    row = given if isinstance(given, list) else [given] * n
    if len(row) != n:
        raise ConfigError(f".{name} needs one number or {n}, not {len(row)}")
    return frozen([_number(name, value) for value in row])


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError(f".{name} needs numbers, not {value!r}")
    least = _LEAST.get(name, 0.0)
    if value < least or (name in _POSITIVE and value <= 0.0):
        raise ConfigError(f".{name} must be {'above' if name in _POSITIVE else 'at least'} {least:g}, not {value}")
    return float(value)
