"""Frames and messages for Hypothesis, biased to what a hand listens to."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hypothesis import strategies as st

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.messages import Message, Request, StatusBits, Topic
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.errors import ProtocolError
from allegro_twin.hands.description.calibration import HandCalibration, load_wiring

Messages = st.SearchStrategy[Message]
UNEVEN = HandCalibration(torque_constant=tuple(0.3 + 0.1 * joint for joint in range(16)))
HANDS: dict[str, Codec] = {
    "v1": make_codec("v1", load_wiring(serial="SAH01010002").calibration),
    "v1 reversed": make_codec("v1", HandCalibration(torque_order="reversed", torque_constant=UNEVEN.torque_constant)),
    "v2": make_codec("v2", load_wiring(serial="SAH020BL016").calibration),
    "v3": make_codec("v3", load_wiring(serial="SAH030C034R_telexistence").calibration),
    "v4": make_codec("v4", UNEVEN),
    "v4 device 3": make_codec("v4", device=3),
    "v5": make_codec("v5", UNEVEN),
    "v5plus": make_codec("v5plus"),
}
LEGACY = ("v1", "v2", "v3")
UNKNOWN = m.Information(0, 0, None).temperature
FINGERS, WORD = st.integers(0, 3), st.integers(0, 0xFFFF)


def _hears(codec: Codec, identifier: int) -> bool:
    try:
        return codec.decode(Frame(identifier)) is not None
    except ProtocolError:
        return True


KNOWN = {name: [number for number in range(0x800) if _hears(codec, number)] for name, codec in HANDS.items()}
"""The identifiers that each hand listens to."""


def frames(name: str) -> st.SearchStrategy[Frame]:
    """Anything that a bus can carry: mostly identifiers that the hand knows, short and full payloads."""
    identifiers = st.sampled_from(KNOWN[name]) | st.integers(0, 0x7FF)
    return st.builds(Frame, identifiers, st.binary(max_size=8) | st.binary(min_size=8, max_size=8), st.booleans())


def messages(codec: Codec) -> list[Messages]:
    """A strategy for every kind of message that the version has, of values that its wire can say exactly."""
    shared: list[Messages] = [
        st.just(m.ServoOn()),
        st.just(m.ServoOff()),
        _made(m.SetTorque, FINGERS, st.just((0.0, 0.0, 0.0, 0.0))),
        FINGERS.flatmap(lambda finger: _positions(codec, finger)),
    ]
    if codec.version in LEGACY:
        return shared + _of_the_first_three()
    return shared + _since_the_fourth(codec) + (_of_the_fifth() if codec.version != "v4" else _of_the_fourth())


def _made(kind: Callable[..., Message], *fields: st.SearchStrategy[Any]) -> Messages:
    """Of these fields alone: st.builds would make up the rest."""
    return st.tuples(*fields).map(lambda values: kind(*values))


def _positions(codec: Codec, finger: int) -> Messages:
    """Whatever eight bytes of a report say is exactly representable."""
    report = codec.encode(m.FingerPosition(finger, (0.0, 0.0, 0.0, 0.0))).id

    def read(data: bytes) -> Message:
        position = codec.decode(Frame(report, data))
        assert position is not None
        return position

    return st.binary(min_size=8, max_size=8).map(read)


def _of_the_first_three() -> list[Messages]:
    return [
        st.sampled_from([Request(Topic.INFORMATION), Request(Topic.STATUS)]),
        _made(m.SetPeriod, _seconds(255)),
        _made(m.SetMode, st.booleans()),
        _made(m.SetAhrs, st.integers(0, 4), st.integers(0, 15)),
        _made(m.Information, WORD, WORD, st.sampled_from(["right", "left"])),
        _made(m.Ahrs, st.sampled_from([1, 2, 4, 8]), st.tuples(WORD, WORD, WORD)),
    ]


def _since_the_fourth(codec: Codec) -> list[Messages]:
    celsius, periods = st.integers(-128, 127).map(float), [_seconds(0xFFFF)] * 3
    parts = [st.integers(-32767, 32767).map(lambda count: count / 32767)] * 4
    goals = FINGERS.flatmap(lambda finger: _positions(codec, finger)).map(lambda p: m.SetPosition(*p))
    return [
        st.sampled_from([Topic.INFORMATION, Topic.SERIAL, Topic.IMU, Topic.STATUS]).map(Request),
        _made(Request, st.sampled_from([Topic.POSITION, Topic.TEMPERATURE]), FINGERS),
        goals,
        _made(m.SetPeriod, *periods),
        _made(m.SetPeriod, *periods, _seconds(0xFFFF)),
        _made(m.Configure, st.none() | st.integers(0, 3), st.none() | st.integers(0, 2**32 - 1)),
        _made(m.FingerTemperature, FINGERS, st.tuples(celsius, celsius, celsius, celsius)),
        _made(m.Imu, st.tuples(*parts)),
        _made(m.Status, _bits()),
        st.text(st.characters(codec="ascii", min_codepoint=33), max_size=8).map(m.Serial),
    ]


def _of_the_fourth() -> list[Messages]:
    celsius = st.integers(-128, 127).map(float)
    return [_made(m.Information, WORD, WORD, st.sampled_from(["right", "left"]), celsius, _bits())]


def _of_the_fifth() -> list[Messages]:
    pascal = st.integers(-(2**31), 2**31 - 1).map(float)
    return [
        st.sampled_from([m.Pick(), m.Place(), m.Calibrate(), m.CalibrationDone()]),
        _made(m.MotorError, st.integers(0, 255), *[st.booleans()] * 4),
        _made(m.FingertipPressure, st.sampled_from([(0, 1), (2, 3)]), st.tuples(pascal, pascal)),
        _made(m.Information, WORD, WORD, st.none(), st.just(UNKNOWN), _bits()),
    ]


def _seconds(most: int) -> st.SearchStrategy[float]:
    return st.integers(0, most).map(lambda ms: ms / 1000)


def _bits() -> st.SearchStrategy[StatusBits]:
    return st.integers(0, 31).map(StatusBits)
