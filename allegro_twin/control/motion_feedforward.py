"""Feedforward of a motion: the torques that it needs by inverse dynamics and by the losses of the hand's drive.

    τ = n − s(q, q̇, n),    n = M(q) q̈ + C(q, q̇) q̇ + A q̈ + B q̇ + F tanh(q̇ / v)

at the place q of the reference where it will be when the torque acts. A: rotor inertia, B: damping, F: dry friction, v:
the speed above which it has its full size, s: torque that a joint feels from elsewhere, such as a cable's, cogging, or
a motor's ripple when it gives n.
The weight is not in it: `GravityFeedforward` carries that where the hand is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from allegro_twin.control.trajectory import Path
from allegro_twin.spec.hand import Actuation
from allegro_twin.types import Vector

RigidTorque: TypeAlias = Callable[[Vector, Vector, Vector], Vector]
"""(q rad, q̇ rad/s, q̈ rad/s²), (n,) each -> torque that links need to move so without gravity, (n,), N·m."""
StrayTorque: TypeAlias = Callable[[Vector, Vector, Vector], Vector]
"""(q rad, q̇ rad/s, torque of the motors N·m), (n,) each -> torque that the joints feel from elsewhere, (n,), N·m."""
FULL = 0.03
"""rad/s. Friction that flips at every change of sign would shake a hand that hardly moves."""
STEP = 0.003
"""s, to both sides: accelerations are differences of the reference's velocities."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionFeedforward:
    """Torques that a motion needs, for hands whose motors each turn a joint of their own."""

    rigid: RigidTorque
    actuation: Actuation
    lead: float = 0.0
    """From a state to the middle of the time in which its torque acts, s."""
    stray: StrayTorque | None = None

    def __call__(self, path: Path, t: float) -> Vector:
        """At a time on a reference's path, s: (n,), N·m."""
        at = max(t + self.lead, 0.0)
        now, before, after = path(at), path(max(at - STEP, 0.0)), path(at + STEP)
        position, velocity = np.asarray(now.position), np.asarray(now.velocity)
        acceleration = (after.velocity - before.velocity) / (at + STEP - max(at - STEP, 0.0))
        drive = self.actuation
        torque: Vector = (
            self.rigid(position, velocity, acceleration)
            + drive.armature * acceleration
            + drive.damping * velocity
            + drive.frictionloss * np.tanh(velocity / FULL)
        )
        return torque if self.stray is None else torque - self.stray(position, velocity, torque)
