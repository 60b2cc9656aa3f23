"""Versions 1 to 3 (SAH010, SAH020, SAH030): one protocol, in which torques go out big-endian and from the tip to the
palm, and encoders come back little-endian and from the palm to the tip.

Identifier = command << 6 | destination << 3 | source. The source of every id and layout:
docs/reference/can_protocol.md.
"""

from __future__ import annotations

import math
from struct import Struct
from typing import ClassVar, Final, Literal

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import Decoder, Encoder, exactly, malformed, no_such, parse_request
from allegro_twin.drivers.can.codec.counts import nearest
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.lanes import Positions, Torques
from allegro_twin.drivers.can.codec.messages import Message, Request, Topic
from allegro_twin.errors import ProtocolError
from allegro_twin.hands.description.calibration import FULL_SCALE, HandCalibration, Version
from allegro_twin.types import frozen

EVERYONE, HOST, FIRST_FINGER = 1, 2, 3  # ID_COMMON, ID_DEVICE_MAIN, ID_DEVICE_SUB_01 of L canDef.h.
SYSTEM_ON, SYSTEM_OFF, SET_PERIOD, MODE_JOINT, MODE_TASK, SET_TORQUE = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
QUERY_STATE, CONTROL_DATA, QUERY_ID, SET_AHRS, AHRS = 0x0E, 0x0F, 0x10, 0x11, 0x12
_BY_HOST: Final = EVERYONE << 3 | HOST
_POSITION: Final = CONTROL_DATA << 6 | HOST << 3 | FIRST_FINGER
_RAD_PER_COUNT = math.radians(333.3 / 65536)  # L main:221, R :569-572, U eq. 1.
_MIDDLE = 32768
_IDENTITY = Struct("<2xHHxB")  # L main:165-170, C :392-396; nobody reads bytes 0, 1 and 6.
_WORDS = Struct(">3H")  # L main:173-203, printed as hexadecimal and never scaled.


class V1To3:
    """The codec of the one hand that a bus of these versions can carry."""

    rad_per_count: ClassVar[float] = _RAD_PER_COUNT
    servo_answer: ClassVar[None] = None

    def __init__(self, version: Literal["v1", "v2", "v3"], calibration: HandCalibration) -> None:
        self.version: Version = version
        self.calibration = calibration
        self.identifies = version == "v3"
        self.count_limit = int(FULL_SCALE[version])
        self.pwm_limits = frozen(calibration.pwm_limits(version))
        self.torques = _torques(version, calibration)
        self.positions = _positions(calibration)
        self._decoders = self._decoding()
        self._encoders = self._encoding()

    def encode(self, message: Message) -> Frame:
        encoder = self._encoders.get(type(message))
        if encoder is None:
            raise no_such(message, self.version)
        return encoder(message)

    def decode(self, frame: Frame) -> Message | None:
        decoder = self._decoders.get(frame.id)
        if decoder is None:
            return None
        if frame.remote:
            raise malformed(frame, f"a {self.version} hand knows no remote frames")
        return decoder(frame)

    def opening(self, position: float, imu: float, temperature: float) -> tuple[Message, ...]:
        """These versions report nothing else in a known unit, so only positions are asked for."""
        return (m.SetPeriod(position), m.SetMode(task=True), Request(Topic.STATUS))

    def closing(self) -> tuple[Message, ...]:
        return (m.ServoOff(),)

    def _encoding(self) -> dict[type, Encoder]:
        return {
            m.ServoOn: lambda _: Frame(_from_host(SYSTEM_ON)),
            m.ServoOff: lambda _: Frame(_from_host(SYSTEM_OFF)),
            m.SetPeriod: self._period_frame,
            m.SetMode: lambda s: Frame(_from_host(MODE_TASK if s.task else MODE_JOINT)),
            m.SetTorque: lambda s: self.torques.frame(s.finger, s.torque),
            m.SetAhrs: lambda s: Frame(_from_host(SET_AHRS), bytes([nearest(s.rate, 0, 4), s.mask & 15])),
            m.Request: self._request_frame,
            m.FingerPosition: lambda p: self.positions.frame(p.finger, p.position),
            m.Information: lambda i: Frame(_from_hand(QUERY_ID), _identity(i)),
            m.Ahrs: _ahrs_frame,
        }

    def _period_frame(self, message: m.SetPeriod) -> Frame:
        if message.imu or message.temperature or message.status:
            raise ProtocolError(f"a {self.version} hand reports nothing but positions by itself: {message}")
        return Frame(_from_host(SET_PERIOD), bytes([nearest(1000.0 * message.position, 0, 0xFF)]))

    def _request_frame(self, request: Request) -> Frame:
        match request.topic:
            case Topic.INFORMATION:
                return Frame(_from_host(QUERY_ID))
            case Topic.STATUS:
                return Frame(_from_host(QUERY_STATE))
            case topic:
                raise ProtocolError(f"a {self.version} hand cannot be asked for its {topic.value}")

    def _decoding(self) -> dict[int, Decoder]:
        """By identifier. The host speaks to everyone; of the hand's frames drivers read command and source alone."""
        table: dict[int, Decoder] = {
            _from_host(SYSTEM_ON): lambda _: m.ServoOn(),
            _from_host(SYSTEM_OFF): lambda _: m.ServoOff(),
            _from_host(SET_PERIOD): lambda frame: m.SetPeriod(exactly(frame, 1)[0] / 1000),
            _from_host(MODE_JOINT): lambda _: m.SetMode(task=False),
            _from_host(MODE_TASK): lambda _: m.SetMode(task=True),
            _from_host(QUERY_STATE): lambda _: Request(Topic.STATUS),
            _from_host(SET_AHRS): lambda frame: m.SetAhrs(*exactly(frame, 2)),
        }
        for addresses in range(64):
            table[QUERY_ID << 6 | addresses] = _read_identity
            for kind in range(4):
                table[AHRS + kind << 6 | addresses] = _ahrs_decoder(1 << kind)
        for identifier, finger in self.torques.fingers.items():
            table[identifier] = self._torque_decoder(finger)
        for identifier, finger in self.positions.fingers.items():
            table[identifier] = self._position_decoder(finger)
        return table

    def _torque_decoder(self, finger: int) -> Decoder:
        read = self.torques.four
        return lambda frame: m.SetTorque(finger, read(finger, exactly(frame, 8)))

    def _position_decoder(self, finger: int) -> Decoder:
        read = self.positions.four
        return lambda frame: m.FingerPosition(finger, read(finger, exactly(frame, 8)))


def _torques(version: Version, calibration: HandCalibration) -> Torques:
    """The motor's direction is its joint's, so it goes on before the order is reversed (R :417, L main:230); by the C
    driver's convention after it (C :340)."""
    full, constant, direction = FULL_SCALE[version], calibration.torque_constant, calibration.motor_direction
    backwards = version != "v1" or calibration.torque_order == "reversed"
    if calibration.convention == "c" and backwards:
        direction = tuple(sign for finger in range(4) for sign in direction[4 * finger : 4 * finger + 4][::-1])
    scale = [sign * full / value for sign, value in zip(direction, constant, strict=True)]
    identifiers = tuple(_from_host(SET_TORQUE + finger) for finger in range(4))
    return Torques(identifiers, ">", scale, int(full), backwards=backwards)


def _positions(calibration: HandCalibration) -> Positions:
    """(count · direction - 32768 - offset) · scale; by the C driver's convention direction · (count - 32768 - offset) ·
    scale (C :376). Drivers look at command and source and ignore the destination."""
    k = _RAD_PER_COUNT
    scale = [sign * k for sign in calibration.encoder_direction]
    turned = calibration.encoder_direction if calibration.convention == "c" else (1,) * len(scale)
    at = [sign * (-_MIDDLE - offset) * k for sign, offset in zip(turned, calibration.encoder_offset, strict=True)]
    reports = {
        CONTROL_DATA << 6 | destination << 3 | FIRST_FINGER + finger: finger
        for destination in range(8)
        for finger in range(4)
    }
    return Positions(tuple(_POSITION + finger for finger in range(4)), "H", scale, at, reports)


def _from_host(command: int) -> int:
    return command << 6 | _BY_HOST


def _from_hand(command: int) -> int:
    """Who answers for the whole hand is in no source, and no driver looks: the first finger stands for it."""
    return command << 6 | HOST << 3 | FIRST_FINGER


def _read_identity(frame: Frame) -> Message:
    if len(frame.data) != 8:
        return parse_request(frame, Request(Topic.INFORMATION), 8)
    hardware, firmware, side = _IDENTITY.unpack(frame.data)
    return m.Information(hardware, firmware, "right" if side else "left")


def _identity(message: m.Information) -> bytes:
    """The flag means the opposite of v4's: 0 is left (C :395)."""
    return _IDENTITY.pack(message.hardware & 0xFFFF, message.firmware & 0xFFFF, int(message.side != "left"))


def _ahrs_decoder(mask: int) -> Decoder:
    def decode(frame: Frame) -> Message:
        if len(frame.data) < 6:
            raise malformed(frame, f"{len(frame.data)} data bytes instead of 6 or more")
        return m.Ahrs(mask, _WORDS.unpack_from(frame.data))

    return decode


def _ahrs_frame(message: m.Ahrs) -> Frame:
    if message.mask not in (1, 2, 4, 8):
        raise ProtocolError(f"an attitude report is of one quantity, 1, 2, 4 or 8, not {message.mask}")
    words = [nearest(value, 0, 0xFFFF) for value in message.values]
    return Frame(_from_hand(AHRS + message.mask.bit_length() - 1), _WORDS.pack(*words))
