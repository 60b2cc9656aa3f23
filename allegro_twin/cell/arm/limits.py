"""Limits of an arm: those of its guard, and the test whether a joint is at its end."""

from __future__ import annotations

from functools import partial

import numpy as np

from allegro_twin.safety import Limits
from allegro_twin.spec.arm import ArmSpec
from allegro_twin.types import HandState, Vector, frozen

_ZONE = 0.05
"""rad. Before a soft stop a torque towards it fades over this stretch: an arm is heavier than a finger."""


def arm_limits(spec: ArmSpec, margin: float = 0.0, velocity: Vector | None = None) -> Limits:
    """For an arm's guard: soft stops `margin` (rad) inside the joints' limits, their speeds and no more than a
    `velocity`, (n,), rad/s."""
    motor, slowing = spec.actuation, spec.slowing
    most = np.full(spec.n_joints, np.inf) if motor.velocity_limit is None else motor.velocity_limit
    if velocity is not None:
        most = frozen(np.minimum(velocity, most))
    return Limits(
        torque=motor.torque_limit,
        velocity=most,
        lower=frozen(spec.lower + margin),
        upper=frozen(spec.upper - margin),
        zone=_ZONE,
        rate=motor.torque_rate,
        speeds=None if slowing is None else partial(slowing.speeds, most=most),
    )


def at_limit(state: HandState, spec: ArmSpec, limits: Limits) -> str | None:
    """Which joint is at its soft stop, where it can go no further, and what to do; None while all have room."""
    room = np.minimum(state.position - limits.lower, limits.upper - state.position)
    joint = int(np.argmin(room))
    if room[joint] > limits.zone / 2.0:
        return None
    low = state.position[joint] - limits.lower[joint] < limits.upper[joint] - state.position[joint]
    end, stop = ("lower", limits.lower) if low else ("upper", limits.upper)
    return (
        f"{spec.joints[joint]} is at {state.position[joint]:.3f} rad, at its {end} limit of {stop[joint]:.3f} rad: "
        f"the arm stands still there; ask for a pose that needs less of it"
    )
