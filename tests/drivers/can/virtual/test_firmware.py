"""The virtual hand does what a hand's own processor does, whoever drives it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.app.rig import SimulatedScene
from allegro_twin.app.serve_can import virtual_firmware
from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.frames import Frame, single
from allegro_twin.drivers.can.codec.messages import StatusBits, Topic
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.virtual.firmware import Firmware
from allegro_twin.drivers.can.virtual.motor_heat import FAULT, THROTTLE, MotorHeat
from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.calibration import Version, load_wiring
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.types import TorqueCommand, frozen
from tests.conftest import MakeSim, can_config
from tests.drivers.can.rigs import PERIOD, half_count

VERSIONS: tuple[Version, ...] = ("v1", "v2", "v3", "v4", "v5", "v5plus")


def virtual(version: Version = "v4", **backend: Any) -> Firmware:
    return virtual_firmware(can_config(version, **backend), SimulatedScene(), step=PERIOD, restart=False)


def started(version: Version = "v4") -> Firmware:
    hand = virtual(version)
    for message in (*hand.codec.opening(PERIOD, 0.0, 0.0), m.ServoOn()):
        hand.receive(hand.codec.encode(message))
    return hand


def positions(hand: Firmware, frames: list[Frame]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """What a whole report says, (16,), rad."""
    read = [message for frame in frames if isinstance(message := hand.codec.decode(frame), m.FingerPosition)]
    assert [message.finger for message in read] == [0, 1, 2, 3]
    return np.array([value for message in read for value in message.position])


@pytest.mark.parametrize("version", VERSIONS)
def test_it_is_silent_until_its_motors_are_on_and_a_period_is_set(version: Version) -> None:
    hand = virtual(version)
    on, period = hand.codec.encode(m.ServoOn()), hand.codec.encode(m.SetPeriod(PERIOD))
    assert hand.step() == []
    for first, second in ((on, period), (period, on)):
        hand.power_up()
        hand.receive(first)
        assert hand.step() == []
        hand.receive(second)
        assert len(single(hand.step())) >= 4
    hand.receive(hand.codec.encode(m.ServoOff()))
    assert hand.step() == []


def test_it_reports_as_often_as_it_is_told() -> None:
    hand = started()
    hand.receive(hand.codec.encode(m.SetPeriod(position=0.009, imu=0.006, temperature=0.03, status=0.015)))
    heard = dict.fromkeys((m.FingerPosition, m.Imu, m.FingerTemperature, m.Status), 0)
    for _ in range(30):
        for frame in single(hand.step()):
            heard[type(hand.codec.decode(frame))] += 1
    assert heard == {m.FingerPosition: 40, m.Imu: 15, m.FingerTemperature: 12, m.Status: 6}


def test_it_keeps_the_last_torque_of_every_finger_for_ever() -> None:
    hand = started()
    hand.receive(hand.codec.encode(m.SetTorque(0, (0.1, 0.0, 0.0, 0.0))))
    hand.receive(hand.codec.encode(m.SetTorque(3, (0.05, 0.0, 0.0, 0.0))))
    for _ in range(200):
        hand.step()
    assert hand.state.torque[[0, 12]] == pytest.approx([0.1, 0.05])
    hand.receive(hand.codec.encode(m.SetTorque(0, (0.0, 0.0, 0.0, 0.0))))  # One finger alone.
    hand.step()
    hand.step()
    assert hand.state.torque[[0, 12]] == pytest.approx([0.0, 0.05])


def test_motors_that_are_off_do_nothing_whatever_was_said() -> None:
    hand = virtual()
    hand.receive(hand.codec.encode(m.SetTorque(0, (0.3, 0.3, 0.3, 0.3))))
    for _ in range(5):
        hand.step()
    assert not hand.state.torque.any()
    hand.receive(hand.codec.encode(m.ServoOn()))
    hand.step()
    hand.step()
    assert hand.state.torque[:4].any()


@pytest.mark.parametrize(
    ("topic", "kind"),
    [
        (Topic.INFORMATION, m.Information), (Topic.SERIAL, m.Serial), (Topic.STATUS, m.Status), (Topic.IMU, m.Imu),
        (Topic.POSITION, m.FingerPosition), (Topic.TEMPERATURE, m.FingerTemperature),
    ],
)  # fmt: skip
def test_questions_are_answered_remote_or_empty_with_motors_on_or_off(topic: Topic, kind: type) -> None:
    """A link that cannot say remote (socketcand) sends an empty frame."""
    for hand in (virtual(), started()):
        asked = hand.codec.encode(m.Request(topic, 2))
        assert asked.remote
        for question in (asked, asked._replace(remote=False)):
            (answer,) = [hand.codec.decode(frame) for frame in hand.receive(question)]
            assert isinstance(answer, kind)
            assert getattr(answer, "finger", 2) == 2


@pytest.mark.parametrize("data", ["030000000000", "0300000000000000"])
def test_period_payloads_of_six_and_eight_bytes_are_taken(data: str) -> None:
    """Six in all manufacturer's code, eight in the manual (M:345) and in FA."""
    hand = virtual()
    hand.receive(Frame(0x204, bytes.fromhex(data)))
    hand.receive(Frame(0x100))
    assert positions(hand, single(hand.step())).shape == (16,)
    hand.receive(Frame(0x204, bytes(len(data) // 2)))
    assert hand.step() == []


INFO, SERIAL = Frame(0x200, remote=True), Frame(0x220, remote=True)
# What the manufacturer's drivers send to begin and to end. facts §1 "Start" and "Stop", all compiled and run there.
STARTS: dict[str, tuple[Version, list[Frame]]] = {
    "L, v1-v3 (main:382-410)": ("v2", [
        Frame(0x40A), Frame(0x44A, b"\x04\x03"), Frame(0x0CA, b"\x03"), Frame(0x14A), Frame(0x38A), Frame(0x38A),
        Frame(0x04A),
    ]),
    "R, v1-v2 (:185-245)": ("v1", [Frame(0x08A), Frame(0x0CA, b"\x03"), Frame(0x14A), Frame(0x04A), Frame(0x38A)]),
    "C, v3 (:222-243)": ("v3", [
        Frame(0x08A), Frame(0x40A), Frame(0x0CA, b"\x03"), Frame(0x14A), Frame(0x38A), Frame(0x38A), Frame(0x04A),
    ]),
    "L4 (main:341-378)": ("v4", [
        INFO, SERIAL, Frame(0x204, bytes.fromhex("030000000000")), Frame(0x100),
    ]),
    "R4 (:114-143)": ("v4", [
        Frame(0x104), INFO, SERIAL, Frame(0x204, bytes.fromhex("030000000000")), Frame(0x100),
    ]),
    "R2 (v4_sdk.cpp:241-289)": ("v4", [
        Frame(0x100), INFO, Frame(0x204, bytes.fromhex("03000000F401")),
    ]),
    "V5R (:137)": ("v5", [
        Frame(0x104), INFO, SERIAL, Frame(0x204, bytes.fromhex("020000000000")), Frame(0x100),
    ]),
    "V5R2 (:136)": ("v5plus", [
        Frame(0x104), INFO, SERIAL, Frame(0x204, bytes.fromhex("030000000000")), Frame(0x100),
    ]),
}  # fmt: skip
STOPS: dict[str, tuple[Version, Frame, bool]] = {
    "L, R, C: system off": ("v2", Frame(0x08A), True),
    "R2: servo off (v4_sdk.cpp:142)": ("v4", Frame(0x104), True),
    "L4, R4: period 0 alone": ("v4", Frame(0x204, bytes(6)), False),
    "V5R: period 0 alone": ("v5", Frame(0x204, bytes(6)), False),
}
"""Whether the motors are off afterwards."""


@pytest.mark.parametrize(("version", "frames"), STARTS.values(), ids=STARTS)
def test_the_manufacturers_start_sequences_bring_reports(version: Version, frames: list[Frame]) -> None:
    hand = virtual(version)
    answers = []
    for frame in frames:
        answers += [type(hand.codec.decode(answer)) for answer in hand.receive(frame)]
    assert len(positions(hand, single(hand.step()))) == 16
    asked = version in ("v4", "v5", "v5plus")
    assert (m.Information in answers) == (asked or version == "v3" or frames[0].id == 0x40A)
    if asked:
        ids = [answer.id for frame in frames for answer in hand.receive(frame)]
        assert 0x200 in ids
        (information,) = hand.receive(Frame(0x200, remote=True))
        assert information.data[1] == (4 if version == "v4" else 5)  # R4 sends no torque otherwise (facts §0.9).


@pytest.mark.parametrize(("version", "stop", "off"), STOPS.values(), ids=STOPS)
def test_the_manufacturers_stop_sequences_end_the_reports(version: Version, stop: Frame, off: bool) -> None:
    hand = started(version)
    hand.receive(hand.codec.encode(m.SetTorque(0, (0.1, 0.0, 0.0, 0.0))))
    hand.step()
    hand.step()
    hand.receive(stop)
    assert hand.step() == []
    assert (hand.state.torque[0] == 0.0) == off  # With period 0 alone the hand keeps its last command (IC README:213).
    assert hand.serving is not off


@pytest.mark.parametrize("version", VERSIONS)
def test_what_it_reports_is_true_within_half_a_count(version: Version) -> None:
    hand = started(version)
    for k in range(60):
        for finger in range(4):
            hand.receive(hand.codec.encode(m.SetTorque(finger, (0.05 * math.sin(k / 9),) * 4)))
        told = positions(hand, single(hand.step()))
        assert np.abs(told - hand.state.position).max() <= half_count(version) * 1.000001
    assert np.ptp(hand.state.position - load_spec().lower) > 0.0


HANDS = sorted(path.stem for path in (data_root() / "conf" / "hands").glob("SAH*.yaml"))


@pytest.mark.parametrize("serial", HANDS)
def test_a_published_hands_encoders_are_read_right_with_its_own_file_and_wrong_without(
    serial: str, make_sim: MakeSim
) -> None:
    wiring = load_wiring(serial=serial)
    assert wiring.version is not None
    spec = load_spec(side=wiring.side or "right")
    codec = make_codec(wiring.version, wiring.calibration)
    rng = np.random.default_rng(0)
    posture = frozen(rng.uniform(spec.lower, spec.upper))
    hand = Firmware(make_sim(spec, posture=posture), codec)
    hand.receive(codec.encode(m.SetPeriod(PERIOD)))
    hand.receive(codec.encode(m.ServoOn()))
    frames = single(hand.step())
    np.testing.assert_allclose(positions(hand, frames), posture, rtol=0, atol=half_count(wiring.version) * 1.000001)
    nominal = make_codec(wiring.version)
    naive = [nominal.decode(frame) for frame in frames]
    wrong = np.array(
        [value for message in naive if isinstance(message, m.FingerPosition) for value in message.position]
    )
    assert np.abs(wrong - posture).max() > 0.05
    torque = tuple(float(x) for x in rng.uniform(-0.2, 0.2, 4))
    hand.receive(codec.encode(m.SetTorque(1, torque)))  # type: ignore[arg-type]  # Four.
    hand.step()
    np.testing.assert_allclose(hand.state.torque[4:8], torque, atol=1 / 800)  # Directions and order undo each other.


def test_fingertips_of_a_v5_hand_feel_what_they_touch() -> None:
    config = can_config("v5").changed(task={"scenario": "rubiks_cube", "posture": None}, controller={"kind": "pd"})
    scene = SimulatedScene()
    hand = virtual_firmware(config, scene, step=PERIOD, restart=False)
    assert scene.trial is not None
    hand.receive(hand.codec.encode(m.SetPeriod(PERIOD)))
    hand.receive(hand.codec.encode(m.ServoOn()))

    def pressures() -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        told = [hand.codec.decode(frame) for frame in single(hand.step())]
        return np.array([p for message in told if isinstance(message, m.FingertipPressure) for p in message.pressure])

    assert pressures().tolist() == [0.0] * 4
    felt = np.zeros(4)
    for finger in range(4):
        hand.receive(hand.codec.encode(m.SetTorque(finger, (0.0, 0.15, 0.15, 0.15))))
    for _ in range(700):
        felt = np.maximum(felt, pressures())
    assert (felt > 100.0).any()


def test_full_torque_makes_a_motor_hot_and_heat_takes_its_torque_away() -> None:
    hand = started()
    full = float(hand.backend.spec.actuation.torque_limit[5])
    hand.receive(hand.codec.encode(m.SetTorque(1, (0.0, full, 0.0, 0.0))))
    hand.motors.temperature[5] = THROTTLE - 0.5
    bits: list[StatusBits] = []
    for _ in range(round(15.0 / PERIOD)):
        hand.step()
        bits.append(hand.status())
    assert bits[0] == StatusBits.SERVO_ON
    assert StatusBits.THROTTLED in bits[-1]
    assert hand.motors.temperature.argmax() == 5
    assert THROTTLE < hand.motors.temperature[5] < FAULT
    assert 0.0 < hand.state.torque[5] < full
    hand.motors.temperature[5] = FAULT + 5.0
    for _ in range(100):
        hand.step()
    assert StatusBits.JOINT_HOT in hand.status()
    assert hand.state.torque[5] == 0.0


def test_a_hand_that_works_at_half_its_torque_ends_a_quarter_as_much_warmer() -> None:
    spec = virtual().backend.spec
    full = spec.actuation.torque_limit
    assert spec.thermal is not None
    motors = MotorHeat(full, spec.thermal, 0.01)
    for _ in range(round(600.0 / (motors.steps * 0.01))):
        motors.warm([full * 0.5] * motors.steps)
    np.testing.assert_allclose(motors.temperature, 25.0 + spec.thermal.rise / 4, atol=0.1)


@pytest.mark.parametrize("restart", [True, False])
def test_a_scene_begins_anew_with_the_session_when_it_is_told_to(restart: bool) -> None:
    hand = virtual_firmware(can_config("v4"), SimulatedScene(), step=PERIOD, restart=restart)
    hand.backend.write(TorqueCommand(np.full(16, 0.1)))
    for _ in range(50):
        hand.step()
    before = hand.state.tick
    hand.receive(hand.codec.encode(m.ServoOn()))
    assert hand.state.tick == (0 if restart else before)


def test_noise_changes_nothing(tmp_path: Path) -> None:
    hand = started()
    for frame in (Frame(0x180, b"\x01"), Frame(0x204, bytes(7)), Frame(0x181, bytes(8)), Frame(0x7FF), Frame(0x180)):
        assert hand.receive(frame) == []
    assert positions(hand, single(hand.step())).shape == (16,)
    assert not hand.state.torque.any()
