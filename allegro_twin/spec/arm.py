"""Spec of an arm: that of a hand with one finger, whose tip is the flange, with load and speed limits."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from allegro_twin.spec.hand import HandSpec
from allegro_twin.types import Vector, frozen


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """Load on an arm's flange, which the arm compensates."""

    mass: float
    """kg."""
    centre: Vector
    """Centre of mass in the flange's frame, shape (3,), m."""


@dataclass(frozen=True, slots=True, eq=False)
class Slowing:
    """Speed limit near the ends of joints: √(b d) - a at a distance d from an end, (n,) each."""

    a: Vector
    """rad/s."""
    b: Vector
    """rad/s²."""
    lower: Vector
    """rad."""
    upper: Vector

    def speeds(self, position: Vector, most: Vector) -> tuple[Vector, Vector]:
        """The fastest down, negative, and up, at a position, (n,), where `most` is the fastest anywhere, rad/s."""
        down, up = (
            np.minimum(np.maximum(np.sqrt(self.b * np.maximum(left, 0.0)) - self.a, _CREEP), most)
            for left in (position - self.lower, self.upper - position)
        )
        return -down, up


_CREEP = 0.05
"""rad/s. OWN: a joint that rests at its end, where it may not move at all, is not still to the last digit."""


@dataclass(frozen=True, slots=True, eq=False)
class ArmSpec(HandSpec):
    """An arm's identity card: that of a hand with one finger, whose tip is the flange, and what an arm has besides.

    An arm carries its own weight and its load: a commanded torque is what comes on top.
    """

    load: Load | None = None
    """None: nothing."""
    ready: Vector = field(default_factory=lambda: frozen(np.empty(0)))
    """Where it waits, elbow bent and flange down, (n,), rad."""
    slowing: Slowing | None = None
    """None: joints are as fast near their ends as elsewhere."""
    silence: float = 0.02
    """s without a command after which it holds itself still, as it does before the first."""

    @property
    def name(self) -> str:
        return self.model

    @property
    def root(self) -> str:
        return f"{self.model}_link0"

    @property
    def rest(self) -> Vector:
        return self.ready

    @property
    def flange(self) -> str:
        """A link in the URDF, a body and a site in the MJCF: where a tool is screwed on, z away from the arm."""
        return f"{self.model}_flange"
