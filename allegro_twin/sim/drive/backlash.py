"""Backlash between a motor and its link: a second joint on the first one's axis, with play between two stops.

    A q̈ = k u − B q̇ − friction − τ,    τ = the links' inverse dynamics at q + p,    |p| ≤ backlash / 2

What turns with the motor (armature A, damping B, friction) stays at the first joint, q; p is the play, in which nothing
but grease holds the link, and τ is what the stops pass on. The encoder sees the link: q + p.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.types import Vector

SMALLEST = 1e-4
"""rad: what a joint without any has in a model that has backlash. Less than the noise of most encoders."""
_GREASE, _TEETH = 1e-4, 0.001  # N·m·s/rad between the teeth; s, how soft they are: twice a step of 0.5 ms.


def add(hand: mujoco.MjSpec, joint: str, backlash: float) -> None:
    """A play of so many rad, both ways together."""
    first = hand.joint(joint)
    play = first.parent.add_joint(name=name_of(joint), pos=first.pos, axis=first.axis)
    play.limited, play.range = mujoco.mjtLimited.mjLIMITED_TRUE, [-backlash / 2.0, backlash / 2.0]
    play.damping, play.solref_limit = [_GREASE, 0, 0], [_TEETH, 1.0]


def name_of(joint: str) -> str:
    return f"{joint}_play"


def tune(model: mujoco.MjModel, plays: NDArray[np.int_], backlash: Vector) -> None:
    """Set it, rad, at some plays of a compiled model."""
    half = np.maximum(backlash, SMALLEST) / 2.0
    model.jnt_range[plays] = np.stack([-half, half], axis=1)
