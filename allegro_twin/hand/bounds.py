"""How near its joint limits a hand may be asked to go."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector, frozen


class Bounds:
    """The joint limits less a margin that can be set, turned on and off."""

    def __init__(self, spec: HandSpec) -> None:
        self._spec = spec
        self._margin: Vector = np.zeros(spec.n_joints)
        self.use_margin = False

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

    def check(self, posture: Vector) -> Vector:
        """The posture. Raises ConfigError naming the joint that comes too near its limit."""
        lower, upper = self.limits
        outside = np.maximum(lower - posture, posture - upper)
        worst = int(np.argmax(outside))
        if outside[worst] > 1e-9:
            raise ConfigError(
                f"posture: {self._spec.readable[worst]} = {posture[worst]:.4f} rad is {outside[worst]:.4f} rad inside "
                f"the margin of its limits [{lower[worst]:.4f}, {upper[worst]:.4f}]; set_margin or use_margin change it"
            )
        return posture
