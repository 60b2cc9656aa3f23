"""Joint speeds from encoder counts."""

from __future__ import annotations

import math

import numpy as np

from allegro_twin.types import Vector


class VelocityFilter:
    """A first-order low-pass of the difference quotient: v ← v + (1 − e^(−2π f_c Δt)) (Δq/Δt − v).

    Its gain at rest is one, for the position is never filtered (the manufacturer's filter reads 1 % low, R4
    allegro_node.cpp:131), and Δt is the time between the two positions, not between two calls. It delays by
    1 / (2π f_c): 5.3 ms at 30 Hz, the cutoff of R2 v4_spec.hpp:65.
    """

    def __init__(self, cutoff: float, position: Vector, velocity: Vector | None = None) -> None:
        """`velocity`: what it has come to so far, (n,), rad/s; None: a hand at rest."""
        self._cutoff, self._position = cutoff, position
        self._velocity: Vector = np.zeros_like(position) if velocity is None else np.array(velocity)
        self._velocity.setflags(write=False)
        self._dt = self._share = 0.0

    @property
    def velocity(self) -> Vector:
        """The last speeds that were known, (n,), rad/s."""
        return self._velocity

    def restart(self, position: Vector) -> None:
        """The time since the last position is not known: the speeds stay, and the next change is from here."""
        self._position = position

    def __call__(self, position: Vector, dt: float) -> Vector:
        """Speeds after `dt` seconds at a new position, both (n,); rad, rad/s."""
        if dt != self._dt:
            self._dt, self._share = dt, 1.0 - math.exp(-2.0 * math.pi * self._cutoff * dt)
        change: Vector = position - self._position
        change /= dt
        change -= self._velocity
        change *= self._share
        change += self._velocity
        change.setflags(write=False)
        self._position, self._velocity = position, change
        return change
