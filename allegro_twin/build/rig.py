"""What a run needs, joined."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from allegro_twin.arm.limits import limits_of as arm_limits
from allegro_twin.arm_spec import ArmSpec
from allegro_twin.backend import HandBackend
from allegro_twin.config import RunConfig
from allegro_twin.config.run import LimitSettings
from allegro_twin.errors import ConfigError
from allegro_twin.loop import Controller
from allegro_twin.safety import Guard, Limits
from allegro_twin.spec import HandSpec
from allegro_twin.types import frozen

if TYPE_CHECKING:
    from allegro_twin.evaluate.trial import Trial
    from allegro_twin.serial.dynamixel.host.backend import DynamixelBackend
    from allegro_twin.serial.polled.backend import PolledBackend
    from allegro_twin.sim.engine.backend import SimBackend
    from allegro_twin.wire.host.backend import CanBackend


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Everything a run needs, ready for `run(rig.backend, rig.controller)`."""

    spec: HandSpec
    backend: HandBackend
    """Behind its guard."""
    controller: Controller[Any]
    seconds: float | None
    """When it is over; None: when the backend ends."""
    trial: Trial | None = None
    """The scenario, where there is one that can be watched."""
    sim: SimBackend | None = None
    """The simulation behind the guard, where there is one: for pictures."""
    wire: CanBackend | None = None
    """The hand on its bus, where there is one: for what its link went through."""
    servos: DynamixelBackend | None = None
    """The hand of servos on its line, where there is one."""
    polled: PolledBackend | None = None
    """The hand that answers when it is asked, where there is one."""

    @property
    def there(self) -> CanBackend | DynamixelBackend | PolledBackend | None:
        """The hand on a wire, of whatever kind; None for one that is only simulated or replayed."""
        return self.wire or self.servos or self.polled

    @property
    def live(self) -> bool:
        """Whether the hand's time passes by itself."""
        return self.there is not None and not self.there.lockstep


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


def guarded(config: RunConfig, spec: HandSpec, backend: HandBackend) -> Guard:
    """A backend behind the config's limits, and for a hand whose fingers could hook into each other behind a look at
    where they would go. Raises ConfigError."""
    limits = limits_of(config.limits, spec)
    if not spec.apart:
        return Guard(backend, limits)
    from allegro_twin.sim.contact.interlock import Interlock

    return Guard(backend, limits, Interlock(spec))


def limits_of(settings: LimitSettings, spec: HandSpec) -> Limits:
    """What a config lets through. Raises ConfigError."""
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
    if isinstance(spec, ArmSpec):
        arm = arm_limits(spec, settings.margin, velocity)
        return replace(arm, torque=frozen(torque))
    lower, upper = spec.lower + settings.margin, spec.upper - settings.margin
    return Limits(frozen(torque), velocity, frozen(lower), frozen(upper))
