"""Servo commands: goal, current limit, and when to let go."""

from __future__ import annotations

from collections.abc import Sequence

from allegro_twin.drivers.dynamixel.codec.calibration import Calibration
from allegro_twin.drivers.dynamixel.driver.sdk import Sdk
from allegro_twin.errors import LinkError, LinkTimeout, ProtocolError
from allegro_twin.types import Vector

_TRIES = 3
_AGAIN = 10
"""Periods after which a current is said again."""


class ServoMotors:
    """Sync writes, which nobody confirms: what must not get lost is read back. Raises LinkError and its kin."""

    def __init__(self, sdk: Sdk, calibration: Calibration, watchdog: int) -> None:
        self._sdk, self._calibration, self._ids, self._watchdog = sdk, calibration, calibration.ids, watchdog
        self.on = False
        """Whether torque may be enabled."""
        self._allowed: Sequence[int] = ()
        self._periods = 0

    def goals(self, position: Vector) -> None:
        """Go there, shape (m,), rad."""
        self._sdk.tell(self._ids, "goal_position", self._calibration.ticks(position))

    def currents(self, effort: Vector | None) -> None:
        """Use no more than this on the way, shape (m,), N·m; None: than the limit. Said when it changes, and again now
        and then, for nobody confirms it; what it can never exceed is in the servos."""
        counts, self._periods = self._counts(effort), self._periods + 1
        if counts != self._allowed or self._periods >= _AGAIN:
            self._allowed, self._periods = counts, 0
            self._sdk.tell(self._ids, "goal_current", counts)

    def start(self, position: Vector, effort: Vector | None) -> None:
        """Torque on, with a limited current, going there. Raises LinkError where it does not come about."""
        self.on = True
        self._allowed = counts = self._counts(effort)
        for _ in range(_TRIES):
            self._each("bus_watchdog", 0)
            self._sdk.tell(self._ids, "goal_current", counts)
            self.goals(position)
            self._each("torque_enable", 1)
            self.goals(position)  # Torque on may have set the goal to where the servo is; the manual does not say.
            self._each("bus_watchdog", self._watchdog)
            if self._are("torque_enable", [1] * len(self._ids)) and self._are("goal_current", counts):
                return
        raise LinkError(f"the servos on {self._sdk.port.name} do not switch on; is something else driving them?")

    def stop(self) -> str:
        """Torque off until all have confirmed it; why they have not, or nothing."""
        why = ""
        for _ in range(_TRIES):
            try:
                self._each("torque_enable", 0)
                if not any(self._sdk.ask_item(self._ids, "torque_enable")):
                    self.on = False
                    return ""
                why = "a servo says that its torque is on"
            except (LinkError, ProtocolError) as error:
                why = str(error).split(";")[0]
        return why

    def _each(self, name: str, value: int) -> None:
        self._sdk.tell(self._ids, name, [value] * len(self._ids))

    def _are(self, name: str, values: Sequence[int]) -> bool:
        try:
            return self._sdk.ask_item(self._ids, name) == list(values)
        except (LinkTimeout, ProtocolError):
            return False  # Lost on the way: the caller asks again.

    def _counts(self, effort: Vector | None) -> Sequence[int]:
        limit = self._calibration.current_counts
        return list(limit) if effort is None else self._calibration.effort_counts(effort)
