"""What every codec promises, and where the versions differ."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.messages import Message, Request, StatusBits, Topic
from allegro_twin.drivers.can.codec.v5 import V5, parse_serial
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.errors import ConfigError, ProtocolError
from allegro_twin.hands.description.calibration import HandCalibration, Version
from allegro_twin.spec import Side
from tests.drivers.can.strategies import FINGERS, HANDS, KNOWN, LEGACY, UNEVEN, frames, messages

FULL = {"v1": 800, "v2": 800, "v3": 1200, "v4": 1200, "v5": 240, "v5plus": 240}
"""Counts that the largest torque becomes."""
ZERO = (0.0, 0.0, 0.0, 0.0)
FRAMES = {name: frames(name) for name in HANDS}
MESSAGES = {name: st.one_of(messages(codec)) for name, codec in HANDS.items()}
each_hand = pytest.mark.parametrize("name", HANDS)


def order(codec: Codec) -> str:
    return ">4h" if codec.version in LEGACY else "<4h"


def understood(codec: Codec, frame: Frame) -> Message:
    message = codec.decode(frame)
    assert message is not None
    return message


def torques(frame: Frame, codec: Codec) -> np.ndarray:
    return np.frombuffer(frame.data, order(codec)[0] + "i2").astype(int)


@each_hand
@given(data=st.data())
def test_every_frame_is_a_message_or_nobodys_or_malformed(name: str, data: st.DataObject) -> None:
    codec, frame = HANDS[name], data.draw(FRAMES[name])
    try:
        message = codec.decode(frame)
    except ProtocolError:
        with pytest.raises(ProtocolError, match=str(frame)):
            codec.decode(frame)
        return
    assert message is None or isinstance(message, get_args(Message))
    if message is not None:
        again = codec.encode(message)
        assert codec.encode(understood(codec, again)) == again


@each_hand
@given(data=st.data())
def test_every_message_of_a_version_comes_back_from_the_wire_as_it_was(name: str, data: st.DataObject) -> None:
    codec, message = HANDS[name], data.draw(MESSAGES[name])
    assert codec.decode(codec.encode(message)) == message


@each_hand
def test_a_version_refuses_the_messages_that_it_does_not_have(name: str) -> None:
    codec = HANDS[name]
    legacy, fifth = codec.version in LEGACY, codec.version in ("v5", "v5plus")
    lacks: list[Message] = [] if fifth else [m.Pick(), m.Calibrate(), m.FingertipPressure((0, 1), (1.0, 1.0))]
    if legacy:
        lacks += [m.SetPosition(0, ZERO), m.Imu((1.0, 0.0, 0.0, 0.0)), m.Serial("A080R"), m.Status(StatusBits(0))]
    else:
        lacks += [m.SetMode(), m.SetAhrs(4, 3), m.Ahrs(1, (0, 0, 0))]
    for message in lacks:
        with pytest.raises(ProtocolError, match=f"a {codec.version} hand has no message {type(message).__name__}"):
            codec.encode(message)


@each_hand
@given(finger=FINGERS, shares=st.tuples(*[st.floats(0.0, 1.0)] * 4))
def test_a_position_comes_back_within_half_a_count(name: str, finger: int, shares: tuple[float, ...]) -> None:
    codec = HANDS[name]
    lowest, highest = (np.array(reach(codec, finger, end)) for end in (-math.inf, math.inf))
    position = lowest + np.array(shares) * (highest - lowest)
    back = codec.decode(codec.encode(m.FingerPosition(finger, tuple(position))))
    assert isinstance(back, m.FingerPosition)
    count = (highest - lowest) / 0xFFFF
    assert (np.abs(np.array(back.position) - position) <= 0.5 * count * (1 + 1e-6)).all()


def reach(codec: Codec, finger: int, beyond: float) -> m.Four:
    """What four encoders report of joints that are beyond their range."""
    back = codec.decode(codec.encode(m.FingerPosition(finger, (beyond,) * 4)))
    assert isinstance(back, m.FingerPosition)
    return back.position


@each_hand
@given(finger=FINGERS, position=st.floats(-1e6, 1e6))
def test_an_encoder_saturates_and_never_wraps(name: str, finger: int, position: float) -> None:
    codec = HANDS[name]
    lowest, highest = reach(codec, finger, -math.inf), reach(codec, finger, math.inf)
    back = codec.decode(codec.encode(m.FingerPosition(finger, (position,) * 4)))
    assert isinstance(back, m.FingerPosition)
    for low, value, high in zip(lowest, back.position, highest, strict=True):
        assert low < high
        assert value == pytest.approx(min(max(position, low), high), abs=1e-3)


@each_hand
@given(finger=FINGERS, data=st.data())
def test_a_torque_that_was_read_is_the_same_counts_again(name: str, finger: int, data: st.DataObject) -> None:
    codec = HANDS[name]
    full = FULL[codec.version]
    counts = data.draw(st.tuples(*[st.integers(-full, full)] * 4))
    frame = Frame(codec.encode(m.SetTorque(finger, ZERO)).id, np.array(counts, order(codec)[0] + "i2").tobytes())
    message = codec.decode(frame)
    assert isinstance(message, m.SetTorque)
    assert codec.encode(message) == frame


@each_hand
@given(finger=FINGERS, torque=st.floats(10.0, allow_nan=False))
def test_a_torque_beyond_full_scale_is_full_scale(name: str, finger: int, torque: float) -> None:
    codec = HANDS[name]
    counts = torques(codec.encode(m.SetTorque(finger, (torque,) * 4)), codec)
    assert (np.abs(counts) == FULL[codec.version]).all()
    np.testing.assert_array_equal(torques(codec.encode(m.SetTorque(finger, (-torque,) * 4)), codec), -counts)


@each_hand
def test_nan_never_reaches_the_wire(name: str) -> None:
    for message in (m.SetTorque(0, (0.0, math.nan, 0.0, 0.0)), m.FingerPosition(0, (0.0, math.nan, 0.0, 0.0))):
        with pytest.raises(ProtocolError, match="NaN"):
            HANDS[name].encode(message)


@each_hand
def test_what_opens_and_closes_a_session_is_said_and_understood(name: str) -> None:
    codec = HANDS[name]
    opening = codec.opening(0.003, 0.0, 0.0)
    assert m.SetPeriod(0.003) in opening
    assert m.ServoOff() in codec.closing()
    for message in (*opening, *codec.closing()):
        assert codec.decode(codec.encode(message)) == message


@pytest.mark.parametrize("version", LEGACY)
def test_torques_of_the_first_three_versions_carry_the_motors_direction(version: Version) -> None:
    signs = (1, -1, -1, 1) * 4
    turned, plain = make_codec(version, HandCalibration(motor_direction=signs)), make_codec(version)
    torque = m.SetTorque(2, (0.1, 0.2, 0.3, 0.4))
    flipped = m.SetTorque(2, (0.1, -0.2, -0.3, 0.4))
    assert turned.encode(torque) == plain.encode(flipped)
    read = turned.decode(turned.encode(torque))
    assert isinstance(read, m.SetTorque)
    np.testing.assert_allclose(read.torque, torque.torque)


def test_by_the_c_drivers_convention_a_hand_turns_as_that_driver_believes() -> None:
    """C :376 and :296-351 by hand: the encoder's direction is about the middle of its range, and the motors' come after
    the order was reversed."""
    signs, offset = (1, -1, -1, -1) * 4, (120,) * 16
    made = HandCalibration(offset, signs, signs, convention="c")
    codec, plain = make_codec("v2", made), make_codec("v2")
    count = 40_000
    report = Frame(plain.encode(m.FingerPosition(0, (0.0,) * 4)).id, count.to_bytes(2, "little") * 4)
    read = codec.decode(report)
    assert isinstance(read, m.FingerPosition)
    angle = np.radians(333.3 / 65536) * (count - 32768 - 120)
    np.testing.assert_allclose(read.position, [angle, -angle, -angle, -angle])
    assert codec.encode(read).data == report.data
    torque = m.SetTorque(1, (0.1, 0.2, 0.3, 0.4))
    sent = [0.4, -0.3, -0.2, -0.1]  # Reversed, then times (1, -1, -1, -1).
    assert codec.encode(torque).data == b"".join(round(800 * each).to_bytes(2, "big", signed=True) for each in sent)
    ours = replace(made, convention="ros")
    assert make_codec("v2", ours).encode(torque) != codec.encode(torque)


def test_torques_run_from_tip_to_palm_on_v2_and_v3_and_as_configured_on_v1() -> None:
    asked = m.SetTorque(0, (0.1, 0.2, 0.3, 0.4))
    backwards = HandCalibration(torque_order="reversed")
    assert make_codec("v2").encode(asked).data.hex() == "014000f000a00050"
    assert make_codec("v3").encode(asked).data.hex() == "01e0016800f00078"
    assert make_codec("v1").encode(asked).data.hex() == "005000a000f00140"
    assert make_codec("v1", backwards).encode(asked) == make_codec("v2").encode(asked)


def test_the_torque_constant_scales_its_own_joint_in_every_version() -> None:
    for version in FULL:
        codec, half = make_codec(version), make_codec(version, HandCalibration(torque_constant=(0.5,) * 16))
        assert half.encode(m.SetTorque(1, (0.01, 0.02, 0.03, 0.04))) == codec.encode(
            m.SetTorque(1, (0.02, 0.04, 0.06, 0.08))
        )
        one = replace(UNEVEN, torque_constant=(1.0, 1.0, 0.5, *(1.0,) * 13))
        only = make_codec(version, one)
        assert only.encode(m.SetTorque(0, (0.01, 0.02, 0.03, 0.04))) == codec.encode(
            m.SetTorque(0, (0.01, 0.02, 0.06, 0.04))
        )


def test_a_geared_joint_of_a_v5_plus_takes_half_the_current() -> None:
    torque = (0.1, 0.1, 0.1, 0.1)
    for finger in range(4):
        plain = torques(make_codec("v5").encode(m.SetTorque(finger, torque)), HANDS["v5"])
        plus = torques(make_codec("v5plus").encode(m.SetTorque(finger, torque)), HANDS["v5"])
        assert list(plain) == [143, 143, 143, 143]
        assert list(plus) == ([143, 71, 143, 143] if finger < 3 else [143, 143, 143, 143])


def test_a_question_and_its_answer_share_an_identifier_and_are_told_apart() -> None:
    asked = Request(Topic.INFORMATION)
    for version in ("v3", "v4", "v5"):
        codec = make_codec(version)
        frame = codec.encode(asked)
        told = m.Information(0x0301, 0x0102, None if version == "v5" else "left", bits=None)
        answer = codec.encode(told)
        assert codec.decode(Frame(frame.id)) == asked, "a link that cannot say remote sends a frame without data"
        assert isinstance(codec.decode(Frame(frame.id, answer.data)), m.Information)
        assert isinstance(codec.decode(answer), m.Information)


def test_the_side_flag_means_the_opposite_on_v3_and_v4_and_nothing_on_v5() -> None:
    sides: tuple[tuple[Side, int, int], ...] = (("left", 0, 1), ("right", 1, 0))
    for side, on_v3, on_v4 in sides:
        told = m.Information(0, 0, side, 20.0, StatusBits(0))
        assert make_codec("v3").encode(told).data[7] == on_v3
        assert make_codec("v4").encode(told).data[4] == on_v4
        read = make_codec("v5").decode(make_codec("v5").encode(told))
        assert isinstance(read, m.Information)
        assert read.side is None


def test_a_v5_hands_serial_tells_its_type_and_side() -> None:
    assert parse_serial("5TBR0017") == ("v5plus", "right")
    assert parse_serial("5TAL0002") == ("v5", "left")
    assert parse_serial("A080R") == (None, None)


def test_a_serial_of_any_bytes_is_read_and_said_again() -> None:
    for data in (b"A080R   ", b"\xff\x80B\x7f1234"):
        frame = Frame(0x220, data)
        assert make_codec("v4").encode(understood(make_codec("v4"), frame)) == frame


def test_fingertip_pressures_are_read_on_both_pairs_of_identifiers_and_said_on_one() -> None:
    told = m.FingertipPressure((2, 3), (120.0, -5.0))
    new, old = V5(HandCalibration()), V5(HandCalibration(), pressures=0x50)
    assert (new.encode(told).id, old.encode(told).id) == (0xF2 << 2, 0x52 << 2)
    for codec in (new, old):
        assert codec.decode(new.encode(told)) == codec.decode(old.encode(told)) == told
    with pytest.raises(ProtocolError, match="together"):
        new.encode(m.FingertipPressure((1, 2), (0.0, 0.0)))


def test_a_v5_error_names_the_motor_and_every_trouble() -> None:
    error = make_codec("v5").decode(Frame(0xEE << 2, bytes([7, 0b100100])))
    assert error == m.MotorError(7, voltage=False, overheat=True, shock=False, overload=True)


def test_two_hands_on_one_bus_do_not_hear_each_other() -> None:
    first, second = make_codec("v4", device=1), make_codec("v4", device=2)
    for message in (m.SetTorque(0, ZERO), m.FingerPosition(3, ZERO), m.ServoOff(), Request(Topic.SERIAL)):
        assert first.decode(first.encode(message)) == message
        assert second.decode(first.encode(message)) is None


@pytest.mark.parametrize("version", FULL)
def test_a_device_that_a_version_cannot_have_is_a_config_error(version: Version) -> None:
    with pytest.raises(ConfigError, match=f"a {version} hand has device ids 0 to"):
        make_codec(version, device=4)


def test_positions_of_the_first_three_versions_are_read_whatever_the_destination() -> None:
    codec = make_codec("v2")
    data = codec.encode(m.FingerPosition(1, ZERO)).data
    assert codec.encode(m.FingerPosition(1, ZERO)).id == 0x3D4
    for destination in range(8):
        assert codec.decode(Frame(0x0F << 6 | destination << 3 | 4, data)) == m.FingerPosition(1, ZERO)


def test_a_remote_frame_on_an_identifier_of_the_first_three_versions_is_malformed() -> None:
    with pytest.raises(ProtocolError, match="a v3 hand knows no remote frames"):
        make_codec("v3").decode(Frame(0x40A, remote=True))


def test_an_identity_that_is_neither_question_nor_answer_is_malformed() -> None:
    for length in (1, 7):
        with pytest.raises(ProtocolError, match=f"{length} data bytes instead of 8"):
            make_codec("v3").decode(Frame(0x40A, bytes(length)))


def test_a_period_that_a_version_cannot_say_is_refused_and_not_dropped() -> None:
    with pytest.raises(ProtocolError, match="nothing but positions"):
        make_codec("v2").encode(m.SetPeriod(0.003, imu=0.01))


def test_a_period_message_is_six_bytes_and_read_at_eight() -> None:
    codec = make_codec("v4")
    assert codec.encode(m.SetPeriod(0.003)).data.hex() == "030000000000"
    assert codec.decode(Frame(0x204, bytes.fromhex("0300000000000a00"))) == m.SetPeriod(0.003, 0.0, 0.0, 0.01)


def test_short_and_long_frames_of_a_known_identifier_are_malformed() -> None:
    for name, codec in HANDS.items():
        for message in (m.SetTorque(0, ZERO), m.FingerPosition(0, ZERO)):
            whole = codec.encode(message)
            assert whole.id in KNOWN[name]
            for length in range(1, 8):
                with pytest.raises(ProtocolError, match=f"{length} data bytes instead of 8"):
                    codec.decode(Frame(whole.id, whole.data[:length]))


@pytest.mark.parametrize("limit", [0, -1])
def test_a_limit_of_no_counts_is_refused_and_of_one_count_taken(limit: int) -> None:
    with pytest.raises(ConfigError, match="pwm_limit must be positive"):
        HandCalibration(pwm_limit=(limit, *(375,) * 15))
    assert HandCalibration(pwm_limit=(1,) * 16).pwm_limits("v4") == (1,) * 16
    full = {"v1": 800, "v2": 800, "v3": 1200, "v4": 1200, "v5": 1430, "v5plus": 1430}
    for version, most in full.items():
        above = HandCalibration(pwm_limit=(most + 1,) * 16)
        assert above.pwm_limits(version) == (most,) * 16  # type: ignore[arg-type]  # A version.


@pytest.mark.parametrize("constant", [0.0, -0.1, math.inf, math.nan])
def test_a_torque_constant_that_is_none_is_refused(constant: float) -> None:
    with pytest.raises(ConfigError, match="torque_constant must be positive"):
        HandCalibration(torque_constant=(constant, *(1.0,) * 15))
