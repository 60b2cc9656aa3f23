"""Joint bounds: how near its joint limits a hand may be asked to go."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.spec import HandSpec
from allegro_twin.spec.hand import GIVE
from allegro_twin.types import Vector, frozen

_ROUNDING = 1e-9  # rad.


class JointBounds:
    """The joint limits less a margin that can be set, turned on and off."""

    def __init__(self, spec: HandSpec) -> None:
        self._spec = spec
        self._margin: Vector = np.zeros(spec.n_joints)
        self.use_margin = False
        self.clipped = 0
        """Set-points from outside that lay beyond the limits by no more than GIVE, and were clipped to them."""

    @property
    def limits(self) -> tuple[Vector, Vector]:
        """Lowest and highest joint positions, margin included, (n,) each, rad."""
        margin = self._margin if self.use_margin else 0.0
        return frozen(self._spec.lower + margin), frozen(self._spec.upper - margin)

    def set_margin(self, general: float | None, percent: float | None, per_joint: ArrayLike | None) -> None:
        """Raises ConfigError unless exactly one is given and leaves every joint a range."""
        given = [value for value in (general, percent, per_joint) if value is not None]
        if len(given) != 1:
            raise ConfigError(f"set_margin takes one of general, percent and per_joint; {len(given)} are given")
        margin = self._spec.vector(given[0], "margin")
        span = self._spec.upper - self._spec.lower
        if percent is not None:
            margin = margin / 100.0 * span
        if (margin < 0).any() or (2 * margin >= span).any():
            raise ConfigError(f"a margin of {given[0]} leaves some joint no range, or is negative")
        self._margin, self.use_margin = margin, True

    def check(self, posture: Vector, what: str = "posture", give: float = _ROUNDING) -> Vector:
        """A posture inside the hand's limits, which may be beyond the margin by no more than `give`, rad. Raises
        ConfigError naming the joint that comes too near its limit."""
        said = self._spec.limit_violation(posture, *self.limits, give, "inside the margin of its limits")
        if said:
            raise ConfigError(f"{what}: {said}; set_margin or use_margin change it")
        return posture

    def admit(self, values: ArrayLike, what: str) -> Vector:
        """The set-point for joint positions that somebody outside asks for, (n,), rad: the only way in for programs
        and people. Beyond the limits, margin included, by no more than GIVE it is clipped to them, and counted; a
        program that sends back what it has read asks for no more. Raises ConfigError, which names `what` asked and the
        joint, for all else."""
        asked = self._spec.vector(values, what)
        self._spec.measured_posture(asked, what)
        posture = frozen(np.clip(self.check(asked, what, GIVE), *self.limits))
        if np.abs(posture - asked).max() > _ROUNDING:
            self.clipped += 1
        return posture
