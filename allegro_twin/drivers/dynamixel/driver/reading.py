"""The state of all servos, whole or an exception; and what they say of themselves now and then."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import cycle, product

import numpy as np

from allegro_twin.drivers.dynamixel.codec.calibration import Calibration
from allegro_twin.drivers.dynamixel.codec.shafts import Shafts
from allegro_twin.drivers.dynamixel.codec.table import TRIPPED
from allegro_twin.drivers.dynamixel.driver.sdk import Sdk, causes
from allegro_twin.errors import HandFault, LinkTimeout, ProtocolError
from allegro_twin.types import Vector

_PRESENT = np.dtype([("current", "<i2"), ("velocity", "<i4"), ("position", "<i4")])
"""Present Current, Velocity and Position, which lie together from address 126 on."""
_FIRST = "present_current"
_ASKED = ("bus_watchdog", "torque_enable", "present_temperature")
"""Slowly, one servo after the other."""


class Reading:
    """Asks the servos. Raises LinkTimeout, ProtocolError, LinkError, or HandFault for what a servo says of itself."""

    QUESTIONS = len(_ASKED)
    """Number of slow questions to each servo."""

    def __init__(self, sdk: Sdk, calibration: Calibration, names: dict[int, str], tries: int) -> None:
        self._sdk, self._calibration, self._names, self._tries = sdk, calibration, names, tries
        self._address = calibration.model.named[_FIRST].address
        self.temperature: Vector = np.full(len(calibration.ids), np.nan)
        """°C, shape (m,); NaN until a servo was asked."""
        self.silent = self.garbled = 0
        """How often an answer did not come, or came garbled, and was asked for again."""
        self._questions = self._turns()

    def warnings(self) -> list[str]:
        """What went wrong without ending the session."""
        counted = {"answers did not come": self.silent, "answers were garbled": self.garbled}
        return [f"{number} {what} and were asked for again" for what, number in counted.items() if number]

    def state(self) -> Shafts:
        """State of the actuators, all of one exchange on the bus."""
        for attempt in range(self._tries):
            try:
                said = self._sdk.ask(self._calibration.ids, self._address, _PRESENT.itemsize)
                break
            except LinkTimeout:
                self.silent += 1
                if attempt + 1 == self._tries:
                    raise LinkTimeout(self._who()) from None
            except ProtocolError:
                self.garbled += 1
                if attempt + 1 == self._tries:
                    raise
        self.check()
        rows, calibration = np.frombuffer(said, _PRESENT), self._calibration
        return Shafts(
            calibration.position(rows["position"].astype(np.float64)),
            calibration.velocity(rows["velocity"].astype(np.float64)),
            calibration.torque(rows["current"].astype(np.float64)),
        )

    def check(self) -> None:
        """Raises HandFault where an answer said that there is a hardware error."""
        if not self._sdk.alerts:
            return
        identifier = min(self._sdk.alerts)
        self._sdk.alerts.clear()
        bits = self._sdk.read(identifier, "hardware_error_status")
        self._sdk.alerts.clear()
        raise HandFault(f"{self._names[identifier]} (id {identifier}): {causes(bits)}; reset reboots it")

    def ask_more(self, *, moving: bool) -> None:
        """The next question of those that are asked slowly. One that gets lost is asked again when its turn comes."""
        k, name = next(self._questions)
        identifier = self._calibration.ids[k]
        try:
            value = self._sdk.read(identifier, name)
        except (LinkTimeout, ProtocolError):
            self.silent += 1
            return
        who = f"{self._names[identifier]} (id {identifier})"
        if name == "present_temperature":
            self.temperature[k] = value
        elif name == "bus_watchdog" and value == TRIPPED:
            raise HandFault(f"{who} was stopped by its bus watchdog: it heard nobody in time; reset to go on")
        elif name == "torque_enable" and moving and not value:
            raise HandFault(f"{who} has switched its motor off: it was told to, or lost its power; reset to go on")

    def first_temperatures(self) -> None:
        """Read the temperatures of all servos at once."""
        self.temperature = np.array(self._sdk.ask_item(self._calibration.ids, "present_temperature"), dtype=np.float64)

    def _turns(self) -> Iterator[tuple[int, str]]:
        return cycle((k, name) for name, k in product(_ASKED, range(len(self._calibration.ids))))

    def _who(self) -> str:
        """Who is silent."""
        ids = [i for i in self._calibration.ids if self._sdk.ping(i) is None]
        where = self._sdk.port.name
        if not ids:
            return f"the servos on {where} answer alone, but not in turn; is the line noisy?"
        if len(ids) == len(self._calibration.ids):
            return f"all {len(ids)} servos on {where} are silent; is the hand powered and plugged in?"
        names = ", ".join(f"{self._names[i]} (id {i})" for i in ids)
        return f"no answer from {names} on {where}; is it powered and plugged in?"
