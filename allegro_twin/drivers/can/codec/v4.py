"""Version 4 (SAH040): every message of the manual, with the manufacturer's code where the two disagree.

Identifier = message << 2 | device; all words are little-endian. The source of every id and layout:
docs/reference/can_protocol.md.
"""

from __future__ import annotations

import math
from struct import Struct
from typing import ClassVar, Final

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import Decoder, Encoder, ServoAnswer, answer, exactly, no_such, parse_request
from allegro_twin.drivers.can.codec.counts import LITTLE, int16, nearest
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.lanes import Positions, Torques
from allegro_twin.drivers.can.codec.messages import Message, Request, StatusBits, Topic
from allegro_twin.hands.description.calibration import FULL_SCALE, HandCalibration, Version, double_geared_joints
from allegro_twin.types import frozen

STATUS, POSITION, IMU, TEMPERATURE = 0x10, 0x20, 0x30, 0x38
SERVO_ON, SERVO_OFF, SET_TORQUE, CONFIG = 0x40, 0x41, 0x60, 0x68
INFORMATION, SET_PERIOD, SERIAL, SET_POSITION = 0x80, 0x81, 0x88, 0xE0
_ASKED = {Topic.STATUS: STATUS, Topic.IMU: IMU, Topic.INFORMATION: INFORMATION, Topic.SERIAL: SERIAL}
_ASKED_BY_FINGER = {Topic.POSITION: POSITION, Topic.TEMPERATURE: TEMPERATURE}
_INFORMATION = Struct("<HHBbB")
_PERIODS, _FOUR_PERIODS = Struct("<3H"), Struct("<4H")
_CONFIG = Struct("<BBI")
_CELSIUS = Struct("<4b")
_ONE: Final = 32767  # A quaternion's 1.0: no source gives the scale (facts conflict 3.7), the full range is assumed.


class V4:
    """The codec of one v4 hand. Frames of another device on the bus are not its own."""

    version: ClassVar[Version] = "v4"
    rad_per_count: ClassVar[float] = math.radians(333.3 / 65536)
    """L4 main:155, R4 AllegroHandDrv.cpp:336, seed 000 eq. 2. The manual's formula (M:431) is 153 times too small."""
    count_limit: ClassVar[int] = 1200
    """Counts that a torque on the wire is cut at. L4 main:169."""
    identifies: ClassVar[bool] = True

    def __init__(self, calibration: HandCalibration, device: int = 0) -> None:
        self.device, self.calibration = device, calibration
        self.pwm_limits = frozen(calibration.pwm_limits(self.version))
        full, doubled = FULL_SCALE[self.version], double_geared_joints(self.version)
        scale = [
            full / (2.0 * constant if joint in doubled else constant)
            for joint, constant in enumerate(calibration.torque_constant)
        ]
        self.torques = Torques(tuple(self._id(SET_TORQUE + k) for k in range(4)), "<", scale, self.count_limit)
        k, offset = self.rad_per_count, calibration.encoder_offset
        angles = [k] * len(offset), [-count * k for count in offset]
        self.positions = Positions(tuple(self._id(POSITION + finger) for finger in range(4)), "h", *angles)
        self.servo_answer = ServoAnswer(Frame(self._id(INFORMATION), remote=True), 6, int(StatusBits.SERVO_ON))
        self._goals = Positions(tuple(self._id(SET_POSITION + finger) for finger in range(4)), "h", *angles)
        self._decoders = self._decoding()
        self._encoders = self._encoding()

    def encode(self, message: Message) -> Frame:
        encoder = self._encoders.get(type(message))
        if encoder is None:
            raise no_such(message, self.version)
        return encoder(message)

    def decode(self, frame: Frame) -> Message | None:
        decoder = self._decoders.get(frame.id)
        return None if decoder is None else decoder(frame)

    def opening(self, position: float, imu: float, temperature: float) -> tuple[Message, ...]:
        return (m.SetPeriod(position, imu, temperature),)

    def closing(self) -> tuple[Message, ...]:
        return (m.ServoOff(), m.SetPeriod(0.0))

    def _id(self, message: int) -> int:
        return message << 2 | self.device

    def _encoding(self) -> dict[type, Encoder]:
        at = self._id
        return {
            m.ServoOn: lambda _: Frame(at(SERVO_ON)),
            m.ServoOff: lambda _: Frame(at(SERVO_OFF)),
            m.SetTorque: lambda s: self.torques.frame(s.finger, s.torque),
            m.SetPosition: lambda s: self._goals.frame(s.finger, s.position),
            m.SetPeriod: lambda s: Frame(at(SET_PERIOD), _periods(s)),
            m.Configure: lambda c: Frame(at(CONFIG), _configuration(c)),
            m.Request: self._request_frame,
            m.FingerPosition: lambda p: self.positions.frame(p.finger, p.position),
            m.FingerTemperature: lambda t: Frame(at(TEMPERATURE + t.finger), _celsius(t)),
            m.Imu: lambda i: Frame(at(IMU), LITTLE.pack(*[int16(_ONE * x) for x in i.orientation])),
            m.Status: lambda s: Frame(at(STATUS), bytes([int(s.bits) & 0xFF])),
            m.Information: lambda i: Frame(at(INFORMATION), _information(i)),
            m.Serial: lambda s: Frame(at(SERIAL), s.text.encode("latin-1", "replace")[:8].ljust(8)),
        }

    def _request_frame(self, request: Request) -> Frame:
        if request.topic in _ASKED_BY_FINGER:
            return Frame(self._id(_ASKED_BY_FINGER[request.topic] + (request.finger or 0)), remote=True)
        return Frame(self._id(_ASKED[request.topic]), remote=True)

    def _decoding(self) -> dict[int, Decoder]:
        """By identifier. What the hand answers to is a request when it comes remote, or without data as from links that
        cannot say remote."""
        at = self._id
        table: dict[int, Decoder] = {
            at(SERVO_ON): lambda _: m.ServoOn(),
            at(SERVO_OFF): lambda _: m.ServoOff(),
            at(SET_PERIOD): _read_periods,
            at(CONFIG): _read_configuration,
            at(IMU): answer(Topic.IMU, None, 8, _read_quaternion),
            at(STATUS): answer(Topic.STATUS, None, 1, lambda data: m.Status(StatusBits(data[0]))),
            at(INFORMATION): answer(Topic.INFORMATION, None, 7, _read_information),
            at(SERIAL): answer(Topic.SERIAL, None, 8, lambda data: m.Serial(data.decode("latin-1").strip("\0 "))),
        }
        for finger in range(4):
            table[at(POSITION + finger)] = self._position_decoder(finger)
            table[at(SET_TORQUE + finger)] = self._torque_decoder(finger)
            table[at(SET_POSITION + finger)] = self._goal_decoder(finger)
            table[at(TEMPERATURE + finger)] = _temperature_decoder(finger)
        return table

    def _position_decoder(self, finger: int) -> Decoder:
        request, read = Request(Topic.POSITION, finger), self.positions.four

        def decode(frame: Frame) -> Message:
            if len(frame.data) == 8 and not frame.remote:
                return m.FingerPosition(finger, read(finger, frame.data))
            return parse_request(frame, request, 8)

        return decode

    def _torque_decoder(self, finger: int) -> Decoder:
        read = self.torques.four
        return lambda frame: m.SetTorque(finger, read(finger, exactly(frame, 8)))

    def _goal_decoder(self, finger: int) -> Decoder:
        read = self._goals.four
        return lambda frame: m.SetPosition(finger, read(finger, exactly(frame, 8)))


def _temperature_decoder(finger: int) -> Decoder:
    def read(data: bytes) -> Message:
        a, b, c, d = _CELSIUS.unpack(data)
        return m.FingerTemperature(finger, (float(a), float(b), float(c), float(d)))

    return answer(Topic.TEMPERATURE, finger, 4, read)


def _read_quaternion(data: bytes) -> Message:
    w, x, y, z = LITTLE.unpack(data)
    return m.Imu((w / _ONE, x / _ONE, y / _ONE, z / _ONE))


def _read_information(data: bytes) -> Message:
    hardware, firmware, side, celsius, bits = _INFORMATION.unpack(data)
    return m.Information(hardware, firmware, "left" if side else "right", float(celsius), StatusBits(bits))


def _read_periods(frame: Frame) -> Message:
    """6 bytes in all manufacturer's code, 8 in the manual (M:345): both are taken."""
    data = exactly(frame, 6, 8)
    if len(data) == 6:
        position, imu, temperature = _PERIODS.unpack(data)
        return m.SetPeriod(position / 1000, imu / 1000, temperature / 1000)
    position, imu, temperature, status = _FOUR_PERIODS.unpack(data)
    return m.SetPeriod(position / 1000, imu / 1000, temperature / 1000, status / 1000)


def _read_configuration(frame: Frame) -> Message:
    flags, device, baud = _CONFIG.unpack(exactly(frame, 6))
    return m.Configure(device & 3 if flags & 1 else None, baud if flags & 2 else None)


def _periods(message: m.SetPeriod) -> bytes:
    ms = [nearest(1000.0 * s, 0, 0xFFFF) for s in message[:3]]
    if message.status is None:
        return _PERIODS.pack(*ms)
    return _FOUR_PERIODS.pack(*ms, nearest(1000.0 * message.status, 0, 0xFFFF))


def _configuration(message: m.Configure) -> bytes:
    flags = (message.device is not None) | (message.baud_rate is not None) << 1
    return _CONFIG.pack(flags, (message.device or 0) & 3, nearest(message.baud_rate or 0, 0, 0xFFFFFFFF))


def _celsius(message: m.FingerTemperature) -> bytes:
    return _CELSIUS.pack(*[nearest(x, -128, 127) for x in message.temperature])


def _information(message: m.Information) -> bytes:
    celsius = 0 if math.isnan(message.temperature) else nearest(message.temperature, -128, 127)
    left = int(message.side == "left")
    return _INFORMATION.pack(
        message.hardware & 0xFFFF, message.firmware & 0xFFFF, left, celsius, int(message.bits or 0)
    )
