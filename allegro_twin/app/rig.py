"""What a run needs, joined."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from allegro_twin.app.config import RunConfig
from allegro_twin.backend import HandBackend
from allegro_twin.cell.arm.limits import limits_of as arm_limits
from allegro_twin.hands.limits import LimitSettings, hand_limits
from allegro_twin.loop import Controller
from allegro_twin.safety import Guard, Limits
from allegro_twin.spec import HandSpec
from allegro_twin.spec.arm import ArmSpec

if TYPE_CHECKING:
    from allegro_twin.drivers.can.driver.backend import CanBackend
    from allegro_twin.drivers.dynamixel.driver.backend import DynamixelBackend
    from allegro_twin.drivers.polled.backend import PolledBackend
    from allegro_twin.grasping.trial import Trial
    from allegro_twin.sim.engine.backend import SimBackend


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


def guarded(config: RunConfig, spec: HandSpec, backend: HandBackend) -> Guard:
    """A backend behind the config's limits, and for a hand whose fingers could hook into each other behind a look at
    where they would go. Raises ConfigError."""
    limits = limits_of(config.limits, spec)
    if not spec.apart:
        return Guard(backend, limits)
    from allegro_twin.sim.contact.interlock import Interlock

    return Guard(backend, limits, Interlock(spec))


def limits_of(settings: LimitSettings, spec: HandSpec) -> Limits:
    """What a config lets through, of a hand or of an arm. Raises ConfigError."""
    limits = hand_limits(settings, spec)
    if not isinstance(spec, ArmSpec):
        return limits
    return replace(arm_limits(spec, settings.margin, limits.velocity), torque=limits.torque)
