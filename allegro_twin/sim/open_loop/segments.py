"""Short pieces of recorded motion, and what stands between their commands and their positions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from allegro_twin.types import Array, Vector

BEFORE = 6
"""Periods of commands that are still on their way when a piece begins: the longest delay."""


@dataclass(frozen=True, slots=True, eq=False)
class Parameters:
    """What is between a fraction of full PWM and a motion, (n,) each."""

    torque_constant: Vector
    """N·m at full PWM."""
    armature: Vector
    """kg·m²."""
    damping: Vector
    """N·m·s/rad."""
    frictionloss: Vector
    """N·m."""
    offset: Vector
    """What a reported position is too high by, rad."""
    delay: Vector
    """s."""
    mass_scale: Vector
    """Factor on the mass of the link that the joint moves."""
    stiction: Vector
    """F_s / F_c, for a player with bristles."""
    stribeck_speed: Vector
    """rad/s, likewise."""
    bristle: Vector
    """rad, likewise."""
    load_friction: Vector
    """What a motor's torque adds to dry friction, as a share of it, likewise."""

    backlash: Vector
    """rad, both ways together, for a player that is loose."""

    def changed(self, name: str, joints: list[int], by: float) -> Self:
        """The same, but for one of them at some joints."""
        values = np.array(getattr(self, name))
        values[joints] += by
        return replace(self, **{name: values})


class Pieces(NamedTuple):
    """Pieces of recordings, all of the same length."""

    duty: Array
    """Fractions of full PWM, (w, BEFORE + k, n): BEFORE periods before the piece, then its own."""
    gravity: Array
    """In the palm frame, (w, 3), m/s²."""
    weight: Array
    """At the fingertips, (w, n), kg, as `Drive.tip_mass`."""
    acceleration: Array
    """Where it begins, (w, n), rad/s²."""
    push: Array
    """Fractions of full PWM around the row where it begins and BEFORE rows before that, as smooth as the acceleration,
    (w, BEFORE + 1, n)."""
