"""Version 5 and version 5 Plus: the messages of v4 with other scales, and what only a v5 hand says.

Identifier = message << 2: there is no device id. The source of every id and layout: docs/reference/can_protocol.md.
"""

from __future__ import annotations

import math
from struct import Struct
from typing import ClassVar, Literal

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import Decoder, Encoder, answer, exactly
from allegro_twin.drivers.can.codec.counts import nearest
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.messages import Message, StatusBits, Topic
from allegro_twin.drivers.can.codec.v4 import INFORMATION, V4
from allegro_twin.errors import ProtocolError
from allegro_twin.hands.description.calibration import HandCalibration, Version
from allegro_twin.spec import Side

PICK, PLACE, MOTOR_ERROR, CALIBRATE, CALIBRATION_DONE = 0x11, 0x12, 0xEE, 0x89, 0x92
PRESSURES = (0xF0, 0x50)
"""Index and middle; two higher: ring and thumb. Which pair a hand sends depends on its firmware: both are read."""
_PAIRS = ((0, 1), (2, 3))
_PASCAL = Struct("<2i")
_INFORMATION = Struct("<HH2xB")  # Bytes 4 and 5, side and temperature on v4, are always 0 (v5 manual 11.3.4).
_VOLTAGE, _OVERHEAT, _SHOCK, _OVERLOAD = 1, 4, 16, 32


class V5(V4):
    """The codec of a v5 hand, type A: every motor has the same gear."""

    version: ClassVar[Version] = "v5"
    rad_per_count: ClassVar[float] = math.radians(0.088)
    """V5R :372, V5R2 :289, v5 manual 11.3.6."""
    count_limit: ClassVar[int] = 240
    """mA. V5R :272-278, V5R2 :230-235."""

    def __init__(self, calibration: HandCalibration, pressures: Literal[0xF0, 0x50] = 0xF0) -> None:
        self._pressures = pressures
        super().__init__(calibration)

    def _encoding(self) -> dict[type, Encoder]:
        at = self._id
        return super()._encoding() | {
            m.Pick: lambda _: Frame(at(PICK)),
            m.Place: lambda _: Frame(at(PLACE)),
            m.Calibrate: lambda _: Frame(at(CALIBRATE)),
            m.CalibrationDone: lambda _: Frame(at(CALIBRATION_DONE)),
            m.FingertipPressure: self._pressure_frame,
            m.MotorError: lambda e: Frame(at(MOTOR_ERROR), bytes([e.motor & 0xFF, _error_bits(e)])),
            m.Information: lambda i: Frame(at(INFORMATION), _information(i)),
        }

    def _pressure_frame(self, message: m.FingertipPressure) -> Frame:
        if message.fingers not in _PAIRS:
            raise ProtocolError(f"a v5 hand reports the pressures of fingers 0, 1 or 2, 3 together: {message}")
        data = _PASCAL.pack(*[nearest(pascal, -(2**31), 2**31 - 1) for pascal in message.pressure])
        return Frame(self._id(self._pressures + message.fingers[0]), data)

    def _decoding(self) -> dict[int, Decoder]:
        at = self._id
        table = super()._decoding() | {
            at(PICK): lambda _: m.Pick(),
            at(PLACE): lambda _: m.Place(),
            at(CALIBRATE): lambda _: m.Calibrate(),
            at(CALIBRATION_DONE): lambda _: m.CalibrationDone(),
            at(MOTOR_ERROR): _read_error,
            at(INFORMATION): answer(Topic.INFORMATION, None, 7, _read_information),
        }
        for first in PRESSURES:
            for pair in _PAIRS:
                table[at(first + pair[0])] = _pressure_decoder(pair)
        return table


class V5Plus(V5):
    """The codec of a v5 Plus hand, type B: the second motor of the three fingers is geared down twice as far."""

    version: ClassVar[Version] = "v5plus"


def parse_serial(serial: str) -> tuple[Version | None, Side | None]:
    """Type and side of a v5 hand, which only its serial tells: `5TBR0017` is a Plus and a right one. None for a letter
    that says neither. V5R2 :269-280."""
    kinds: dict[str, Version] = {"A": "v5", "B": "v5plus"}
    sides: dict[str, Side] = {"R": "right", "L": "left"}
    return kinds.get(serial[2:3]), sides.get(serial[3:4])


def _pressure_decoder(pair: tuple[int, int]) -> Decoder:
    def decode(frame: Frame) -> Message:
        first, second = _PASCAL.unpack(exactly(frame, 8))
        return m.FingertipPressure(pair, (float(first), float(second)))

    return decode


def _read_error(frame: Frame) -> Message:
    motor, bits = exactly(frame, 2)
    return m.MotorError(motor, *(bool(bits & bit) for bit in (_VOLTAGE, _OVERHEAT, _SHOCK, _OVERLOAD)))


def _error_bits(error: m.MotorError) -> int:
    return _VOLTAGE * error.voltage + _OVERHEAT * error.overheat + _SHOCK * error.shock + _OVERLOAD * error.overload


def _read_information(data: bytes) -> Message:
    hardware, firmware, bits = _INFORMATION.unpack(data)
    return m.Information(hardware, firmware, None, bits=StatusBits(bits))


def _information(message: m.Information) -> bytes:
    return _INFORMATION.pack(message.hardware & 0xFFFF, message.firmware & 0xFFFF, int(message.bits or 0) & 0xFF)
