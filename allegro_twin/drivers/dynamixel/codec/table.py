"""The control table of the XM430-W350, and how another model's differs from it.

ROBOTIS e-Manual, xm430-w350 and xc330-m288, with ranges from its pages of each item; addresses and sizes agree with the
`.model` files of dynamixel-sdk 4.1.0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from allegro_twin.errors import ConfigError, unknown

RPM = 2.0 * math.pi / 60.0
EEPROM_END = 64
"""From here on the table is RAM: written at any time, forgotten without power."""
TURN = 4096
"""Ticks a turn of the shaft."""
FARTHEST = 1_048_575
"""Ticks either way in the modes that count turns: 256 turns."""
BAUDS = (9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
"""What the values 0 … 7 of Baud Rate stand for."""
CURRENT, VELOCITY, POSITION, EXTENDED, CURRENT_POSITION, PWM = 0, 1, 3, 4, 5, 16
MODES = (CURRENT, VELOCITY, POSITION, EXTENDED, CURRENT_POSITION, PWM)
WATCHDOG_UNIT = 0.02
"""s."""
TRIPPED = -1
"""What Bus Watchdog says once it has struck."""
ERRORS = {0: "input voltage", 2: "overheating", 3: "motor encoder", 4: "electrical shock", 5: "overload"}
"""Bits of Hardware Error Status and of Shutdown."""


class Field(NamedTuple):
    """An item of a control table."""

    address: int
    size: int
    """Bytes: 1, 2 or 4."""
    name: str
    writable: bool
    default: int
    low: int
    high: int
    signed: bool

    def bytes_of(self, value: int) -> bytes:
        """As it stands in the table, little-endian."""
        return value.to_bytes(self.size, "little", signed=value < 0)

    def value_of(self, data: bytes) -> int:
        return int.from_bytes(data, "little", signed=self.signed)


def _rw(address: int, size: int, name: str, default: int, low: int, high: int) -> Field:
    return Field(address, size, name, True, default, low, high, low < 0)


def _r(address: int, size: int, name: str, default: int = 0, *, signed: bool = False) -> Field:
    bits = 8 * size - signed
    return Field(address, size, name, False, default, -(1 << bits) if signed else 0, (1 << bits) - 1, signed)


_XM430 = (
    _r(0, 2, "model_number", 1020),
    _r(2, 4, "model_information"),
    _r(6, 1, "firmware_version", 45),
    _rw(7, 1, "id", 1, 0, 252),
    _rw(8, 1, "baud_rate", 1, 0, 7),
    _rw(9, 1, "return_delay", 250, 0, 254),
    _rw(10, 1, "drive_mode", 0, 0, 5),
    _rw(11, 1, "operating_mode", 3, 0, 16),
    _rw(12, 1, "shadow_id", 255, 0, 255),
    _rw(13, 1, "protocol_type", 2, 2, 2),  # Protocol 1.0 is not modelled.
    _rw(20, 4, "homing_offset", 0, -1_044_479, 1_044_479),
    _rw(24, 4, "moving_threshold", 10, 0, 1023),
    _rw(31, 1, "temperature_limit", 80, 0, 100),
    _rw(32, 2, "max_voltage_limit", 160, 95, 160),
    _rw(34, 2, "min_voltage_limit", 95, 95, 160),
    _rw(36, 2, "pwm_limit", 885, 0, 885),
    _rw(38, 2, "current_limit", 1193, 0, 1193),
    _rw(40, 4, "acceleration_limit", 32767, 0, 32767),
    _rw(44, 4, "velocity_limit", 350, 0, 1023),
    _rw(48, 4, "max_position_limit", 4095, 0, 4095),
    _rw(52, 4, "min_position_limit", 0, 0, 4095),
    _rw(63, 1, "shutdown", 52, 0, 255),
    _rw(64, 1, "torque_enable", 0, 0, 1),
    _rw(65, 1, "led", 0, 0, 1),
    _rw(68, 1, "status_return_level", 2, 0, 2),
    _r(69, 1, "registered_instruction"),
    _r(70, 1, "hardware_error_status"),
    _rw(76, 2, "velocity_i_gain", 1920, 0, 16383),
    _rw(78, 2, "velocity_p_gain", 100, 0, 16383),
    _rw(80, 2, "position_d_gain", 0, 0, 16383),
    _rw(82, 2, "position_i_gain", 0, 0, 16383),
    _rw(84, 2, "position_p_gain", 800, 0, 16383),
    _rw(88, 2, "feedforward_2nd_gain", 0, 0, 16383),
    _rw(90, 2, "feedforward_1st_gain", 0, 0, 16383),
    _rw(98, 1, "bus_watchdog", 0, -1, 127),
    _rw(100, 2, "goal_pwm", 885, -885, 885),
    _rw(102, 2, "goal_current", 1193, -1193, 1193),
    _rw(104, 4, "goal_velocity", 0, -1023, 1023),
    _rw(108, 4, "profile_acceleration", 0, 0, 32767),
    _rw(112, 4, "profile_velocity", 0, 0, 32767),
    _rw(116, 4, "goal_position", 0, -FARTHEST, FARTHEST),
    _r(120, 2, "realtime_tick"),
    _r(122, 1, "moving"),
    _r(123, 1, "moving_status"),
    _r(124, 2, "present_pwm", signed=True),
    _r(126, 2, "present_current", signed=True),
    _r(128, 4, "present_velocity", signed=True),
    _r(132, 4, "present_position", signed=True),
    _r(136, 4, "velocity_trajectory", signed=True),
    _r(140, 4, "position_trajectory", signed=True),
    _r(144, 2, "present_input_voltage", 120),
    _r(146, 1, "present_temperature", 25),
)
# What is otherwise on the XC330-M288. It has no acceleration limit, and 20 indirect addresses in one block. Where their
# data begin the manual says 208, and the SDK's file 224: the manual's holds here, for it lists every item.
_XC330_M288 = (
    _r(0, 2, "model_number", 1240),
    _rw(8, 1, "baud_rate", 1, 0, 6),
    _rw(31, 1, "temperature_limit", 70, 0, 100),
    _rw(32, 2, "max_voltage_limit", 70, 31, 70),
    _rw(34, 2, "min_voltage_limit", 35, 31, 70),
    _rw(38, 2, "current_limit", 2352, 0, 2352),
    _rw(44, 4, "velocity_limit", 350, 0, 2047),
    _rw(60, 1, "startup_configuration", 0, 0, 3),
    _rw(62, 1, "pwm_slope", 140, 1, 255),
    _rw(76, 2, "velocity_i_gain", 1600, 0, 16383),
    _rw(78, 2, "velocity_p_gain", 50, 0, 16383),
    _rw(80, 2, "position_d_gain", 500, 0, 16383),
    _rw(84, 2, "position_p_gain", 1100, 0, 16383),
    _rw(102, 2, "goal_current", 2352, -2352, 2352),
    _rw(104, 4, "goal_velocity", 0, -2047, 2047),
    _r(144, 2, "present_input_voltage", 50),
)


@dataclass(frozen=True, eq=False)
class Model:
    """A kind of servo."""

    name: str
    fields: tuple[Field, ...] = field(repr=False)
    """In the order of their addresses."""
    current_unit: float
    """A a count."""
    torque_per_ampere: float
    """At the shaft, N·m/A: stall torque over stall current of the data sheet."""
    indirect: tuple[tuple[int, int, int], ...] = ()
    """Blocks of indirect addressing: the first address of the pointers, of the data, and how many."""
    velocity_unit: float = 0.229 * RPM
    """rad/s a count."""

    @cached_property
    def named(self) -> dict[str, Field]:
        return {item.name: item for item in self.fields}

    @cached_property
    def at(self) -> dict[int, Field]:
        """The item that each byte of the table belongs to."""
        return {item.address + k: item for item in self.fields for k in range(item.size)}

    @property
    def number(self) -> int:
        return self.named["model_number"].default

    @property
    def bauds(self) -> tuple[int, ...]:
        return BAUDS[: self.named["baud_rate"].high + 1]


def _with(base: tuple[Field, ...], changed: tuple[Field, ...], without: str) -> tuple[Field, ...]:
    items = {item.address: item for item in base if item.name != without} | {item.address: item for item in changed}
    return tuple(items[address] for address in sorted(items))


XM430_W350 = Model("XM430-W350", _XM430, 2.69e-3, 4.1 / 2.3, ((168, 224, 28), (578, 634, 28)))
XC330_M288 = Model("XC330-M288", _with(_XM430, _XC330_M288, "acceleration_limit"), 1e-3, 0.93 / 1.80, ((168, 208, 20),))
MODELS = {model.name: model for model in (XM430_W350, XC330_M288)}


def model_named(name: str) -> Model:
    """A model by its name. Raises ConfigError with the nearest names."""
    if name not in MODELS:
        raise ConfigError(unknown("servo model", name, MODELS))
    return MODELS[name]
