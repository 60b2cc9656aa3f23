"""Limits of a hand: torques, speeds and positions of its guard, and the longest control period."""

from __future__ import annotations

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.hands.settings import LimitSettings
from allegro_twin.safety import Limits
from allegro_twin.spec import HandSpec
from allegro_twin.types import frozen

SLOWEST_LOOP = 0.01
"""s. The longest period in which a loop outside the hand keeps its joints: `home` under PID is reached within 0.001 rad
at 0.01 s, simulated and behind CAN; at 0.02 s joints on CAN stay 0.03 rad away, at 0.1 s simulated ones 0.26 rad."""
SLOWEST_SETPOINTS = 0.1
"""s, of set-points for a hand that closes its own loop. The loops need no less (the simulated hands reach their posture
at 0.3 s, too), but the guard looks once a period: in 0.1 s a joint at its limit of 12 rad/s moves by 1.2 rad."""


def check_period(period: float, spec: HandSpec, controller: str = "") -> None:
    """Raises ConfigError for a control period, s, with which nobody can drive the hand, or arm. `controller`: its kind;
    one of given torques closes no loop."""
    own, open_loop = "torque" not in spec.commands, controller == "torque"
    slowest = SLOWEST_SETPOINTS if own or open_loop else SLOWEST_LOOP
    if period <= slowest + 1e-12:
        return
    what = "set-points for its own loop" if own else "torques" if open_loop else "its joints' loop"
    hint = f"; it is in seconds: {period:g} ms is {period / 1e3:g}" if period >= 0.5 and period / 1e3 <= slowest else ""
    raise ConfigError(f"period {period:g} s: {spec.name} needs {what} every {slowest:g} s at least{hint}")


def hand_limits(settings: LimitSettings, spec: HandSpec) -> Limits:
    """The limits of a hand's guard. Raises ConfigError."""
    torque = spec.actuation.torque_limit
    if settings.torque is not None:
        if not {"torque", "limited_position"} & set(spec.commands):
            raise ConfigError(f"limits.torque: nobody can limit the effort of {spec.name}")
        torque = np.minimum(torque, spec.vector(settings.torque, "limits.torque"))
    velocity = spec.vector(settings.velocity, "limits.velocity")
    for name, values in (("torque", torque), ("velocity", velocity)):
        if not (values > 0).all():
            raise ConfigError(f"limits.{name} must be positive; it is {values.min()}")
    if settings.margin * 2 >= float((spec.upper - spec.lower).min()):
        raise ConfigError(f"limits.margin {settings.margin} rad leaves some joint no range")
    lower, upper = spec.lower + settings.margin, spec.upper - settings.margin
    return Limits(frozen(torque), velocity, frozen(lower), frozen(upper))
