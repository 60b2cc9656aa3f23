"""A hand of DYNAMIXEL servos, through the vendor's SDK."""

from __future__ import annotations

from collections.abc import Callable

from allegro_twin.drivers.base.backend import SerialBackend
from allegro_twin.drivers.base.serial_line import LATENCY, SerialLine
from allegro_twin.drivers.dynamixel.codec import budget
from allegro_twin.drivers.dynamixel.codec.calibration import Calibration
from allegro_twin.drivers.dynamixel.codec.shafts import Joints
from allegro_twin.drivers.dynamixel.driver.driver import ServoDriver
from allegro_twin.drivers.dynamixel.driver.host_settings import ServoHostSettings
from allegro_twin.drivers.dynamixel.driver.line import SdkLine
from allegro_twin.spec import HandSpec


class DynamixelBackend(SerialBackend):
    """All servos of a hand are asked at once. `joints`: how joints follow from actuators; `latency`: s that an answer
    may take beside its bytes."""

    def __init__(
        self,
        spec: HandSpec,
        calibration: Calibration,
        open_port: Callable[[], SerialLine],
        settings: ServoHostSettings | None = None,
        *,
        joints: Joints | None = None,
        latency: float = LATENCY,
    ) -> None:
        calibration.check(spec)
        chosen = settings or ServoHostSettings()

        def driver(port: SerialLine) -> ServoDriver:
            n = len(calibration.ids)
            budget.check(chosen.period, budget.budget(n, port.baud, chosen.return_delay, limited=True))
            return ServoDriver(spec, calibration, SdkLine(port, latency), chosen, joints)

        super().__init__(spec, open_port, driver, chosen)
