"""The mathematics of control: arrays in, arrays out, broadcasting over leading batch dimensions `(..., n)`.

Torques are in N·m, positions in rad, gains in N·m/rad, N·m·s/rad and N·m/(rad·s).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from allegro_twin.types import Array


class PidResult(NamedTuple):
    torque: Array
    integral: Array
    """The integral term after this step, N·m."""


def known_rate(rate: Array) -> Array:
    """Joint speeds for damping: an unknown speed, NaN, damps nothing."""
    return np.where(np.isnan(rate), 0.0, rate)


def pd(error: Array, rate_error: Array, kp: Array, kd: Array, feedforward: Array | float = 0.0) -> Array:
    """τ = Kp e + Kd ė + τ_ff."""
    return kp * error + kd * rate_error + feedforward


def pid(
    error: Array,
    rate_error: Array,
    integral: Array,
    dt: float,
    kp: Array,
    ki: Array,
    kd: Array,
    clamp: Array,
    torque_limit: Array,
    feedforward: Array | float = 0.0,
) -> PidResult:
    """τ = Kp e + Kd ė + I + τ_ff, with I += Ki e dt.

    The integral is held within ±clamp, and does not grow while the torque it asks for is beyond ±torque_limit
    (conditional integration), so that a long way to go leaves nothing to unwind.
    """
    without = pd(error, rate_error, kp, kd, feedforward)
    step = ki * error * dt
    grown = np.minimum(np.maximum(integral + step, -clamp), clamp)
    windup = (np.abs(without + grown) > torque_limit) & (step * (without + grown) > 0.0)
    integral = np.where(windup, integral, grown)
    return PidResult(without + integral, integral)
