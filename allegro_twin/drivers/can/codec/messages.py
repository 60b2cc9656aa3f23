"""CAN messages between host and hand in SI units, common to all versions of the hand.

Fingers are counted 0 index, 1 middle, 2 ring, 3 thumb; the four values of a finger go from the palm outward.
"""

from __future__ import annotations

from enum import Enum, IntFlag
from typing import NamedTuple, TypeAlias

from allegro_twin.spec import Side

Four: TypeAlias = tuple[float, float, float, float]


class ServoOn(NamedTuple):
    """Engage the motor drivers (v1–v3: system on)."""


class ServoOff(NamedTuple):
    """Release the motor drivers (v1–v3: system off)."""


class SetTorque(NamedTuple):
    """Torques of one finger, held by the hand until replaced."""

    finger: int
    torque: Four
    """N·m."""


class SetPosition(NamedTuple):
    """Position set-points of one finger; no known firmware of v1–v4 acts on it."""

    finger: int
    position: Four
    """rad."""


class SetPeriod(NamedTuple):
    """Periods of the hand's own reports; 0: never."""

    position: float
    """s."""
    imu: float = 0.0
    """s."""
    temperature: float = 0.0
    """s."""
    status: float | None = None
    """s; None: leave the field out, as the manufacturer's drivers do."""


class SetMode(NamedTuple):
    """v1–v3: who closes the loop; with `task` the host sends torques."""

    task: bool = True


class SetAhrs(NamedTuple):
    """v1–v3: what the attitude sensor reports, and how often."""

    rate: int
    """0 … 4 for 1, 10, 20, 50, 100 Hz."""
    mask: int
    """1 pose, 2 acceleration, 4 angular velocity, 8 magnetic field."""


class Configure(NamedTuple):
    """v4: store a device id or the RS-485 baud rate in the hand; None leaves it."""

    device: int | None = None
    baud_rate: int | None = None


class Pick(NamedTuple):
    """v5: a command of the manufacturer's drivers whose effect is not documented."""


class Place(NamedTuple):
    """v5: the counterpart of Pick."""


class Calibrate(NamedTuple):
    """v5: begin the calibration of the encoders."""


class Topic(Enum):
    """Topic of a request to the hand."""

    INFORMATION = "information"
    SERIAL = "serial"
    POSITION = "position"
    IMU = "imu"
    TEMPERATURE = "temperature"
    STATUS = "status"


class Request(NamedTuple):
    """Ask the hand to say something now."""

    topic: Topic
    finger: int | None = None
    """For positions and temperatures of v4 and later."""


class FingerPosition(NamedTuple):
    """Joint positions of one finger."""

    finger: int
    position: Four
    """rad."""


class FingerTemperature(NamedTuple):
    """Motor temperatures of one finger."""

    finger: int
    temperature: Four
    """°C."""


class Imu(NamedTuple):
    """Orientation of the palm."""

    orientation: Four
    """Unit quaternion w, x, y, z; palm to world."""


class Ahrs(NamedTuple):
    """v1–v3: three raw words of the attitude sensor, whose scale is not published."""

    mask: int
    """Which quantity: a bit of SetAhrs.mask."""
    values: tuple[int, int, int]


class StatusBits(IntFlag):
    """The manual's status field (v4.0, Information)."""

    SERVO_ON = 1
    JOINT_HOT = 2
    THROTTLED = 4
    JOINT_TIMEOUT = 8
    PALM_HOT = 16


class Status(NamedTuple):
    bits: StatusBits


class Information(NamedTuple):
    """Identity of the hand."""

    hardware: int
    firmware: int
    side: Side | None
    """None where the version does not tell (v5: its serial does)."""
    temperature: float = float("nan")
    """Temperature of the palm, °C; NaN where the version does not report it."""
    bits: StatusBits | None = None
    """None where the version does not tell."""


class Serial(NamedTuple):
    text: str


class FingertipPressure(NamedTuple):
    """v5: pressures of two fingertips."""

    fingers: tuple[int, int]
    pressure: tuple[float, float]
    """Pa."""


class MotorError(NamedTuple):
    """v5: a motor reports trouble."""

    motor: int
    voltage: bool
    overheat: bool
    shock: bool
    overload: bool


class CalibrationDone(NamedTuple):
    """v5: the answer to Calibrate."""


Message: TypeAlias = (
    ServoOn | ServoOff | SetTorque | SetPosition | SetPeriod | SetMode | SetAhrs | Configure | Pick | Place | Calibrate
    | Request | FingerPosition | FingerTemperature | Imu | Ahrs | Status | Information | Serial | FingertipPressure
    | MotorError | CalibrationDone
)  # fmt: skip

COMMANDS = (
    ServoOn, ServoOff, SetTorque, SetPosition, SetPeriod, SetMode, SetAhrs, Configure, Pick, Place, Calibrate,
)  # fmt: skip
"""What changes what a hand does; the rest are questions, answers and reports."""
