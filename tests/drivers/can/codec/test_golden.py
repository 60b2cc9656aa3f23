"""Frames of the manufacturer's own drivers: what they send for given commands, and what they read from given frames.

can_vectors.json was recorded from those drivers, compiled against a stubbed CAN back end; `variant` names whose code
(docs/reference/can_protocol.md). Each row is compared twice: its meaning, built here from the row's inputs in SI
units, must encode
to exactly that frame, and the frame must decode to that meaning, positions within the row's tolerance, torques within
the count that truncation takes. The hands' calibrations come from conf/hands.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.messages import Message, Request, StatusBits, Topic
from allegro_twin.drivers.can.codec.v4 import V4
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.hands.description.calibration import load_wiring

Row = dict[str, Any]
VECTORS: dict[str, list[Row]] = json.loads(Path(__file__).with_name("can_vectors.json").read_text())
ROWS = [pytest.param(version, row, id=row["vector_id"]) for version, rows in VECTORS.items() for row in rows]
INFORMATION, SERIAL, OFF = Request(Topic.INFORMATION), Request(Topic.SERIAL), m.SetPeriod(0.0)
LEGACY: dict[str, Message] = {
    "SYSTEM_ON": m.ServoOn(),
    "SYSTEM_OFF": m.ServoOff(),
    "SET_MODE_TASK": m.SetMode(task=True),
    "QUERY_STATE_DATA": Request(Topic.STATUS),
    "QUERY_ID": INFORMATION,
}
SEQUENCES: dict[tuple[str, str], tuple[Message, ...]] = {
    ("linux_v4", "open"): (INFORMATION, SERIAL, m.SetPeriod(0.003), m.ServoOn()),
    ("ros_v4", "open"): (m.ServoOff(), INFORMATION, SERIAL, m.SetPeriod(0.003), m.ServoOn()),
    ("ros2_v4", "open"): (m.ServoOn(), INFORMATION, m.SetPeriod(0.003, 0.0, 0.5)),
    ("ros_v5", "open"): (m.ServoOff(), INFORMATION, SERIAL, m.SetPeriod(0.002), m.ServoOn()),
    ("ros2_v5", "open"): (m.ServoOff(), INFORMATION, SERIAL, m.SetPeriod(0.003), m.ServoOn()),
    ("sense", "open"): (m.ServoOff(), INFORMATION, SERIAL, m.SetPeriod(0.003), m.ServoOn()),
    ("linux_v4", "close"): (OFF,),
    ("ros_v4", "close"): (OFF,),
    ("ros2_v4", "close"): (m.ServoOff(),),
    ("ros_v5", "close"): (OFF,),
}


def frame_of(row: Row) -> Frame:
    assert not row["is_extended"]
    frame = Frame(int(row["arbitration_id"], 16), bytes.fromhex(row["data_hex"]), row["is_rtr"])
    assert len(frame.data) == row["dlc"]
    return frame


def codec_of(version: str, row: Row) -> Codec:
    """A v4 hand takes the row's device id from its identifier; v1–v3 take the named hand's file."""
    if version == "v5":
        return make_codec("v5plus" if row["hand"].startswith("type B") else "v5")
    if version == "v4":
        return make_codec("v4", device=frame_of(row).id & 3)
    return make_codec(version, load_wiring(serial=row["hand"]).calibration)


def meaning(version: str, row: Row) -> Message:
    """What the row's inputs, or what the driver made of the frame, are in our words."""
    kind, given = row["kind"].removesuffix("_tx"), row["inputs"]
    if kind in BUILT:
        finger: int = given.get("finger", row["finger"])
        return BUILT[kind](given, row["expected"], finger)
    if kind == "fingertip_rx":
        fingers = {0xF0: (0, 1), 0xF2: (2, 3)}[frame_of(row).id >> 2]
        return m.FingertipPressure(fingers, tuple(given["raw_i32"]))
    if given.get("meaning") == "SET_PERIOD":
        return m.SetPeriod(given.get("period_ms", 3) / 1000)
    if "meaning" in given:
        return LEGACY[given["meaning"]]
    if kind in ("open_sequence", "close_sequence"):
        step: int = given["step"]
        return SEQUENCES[row["variant"], kind.removesuffix("_sequence")][step]
    return SIMPLE[kind]


SIMPLE: dict[str, Message] = {
    "servo_on": m.ServoOn(),
    "servo_off": m.ServoOff(),
    "pick": m.Pick(),
    "place": m.Place(),
    "period_stop": OFF,
    "rtr_info": INFORMATION,
    "info": INFORMATION,
    "rtr_serial": SERIAL,
    "serial": SERIAL,
    "rtr_imu": Request(Topic.IMU),
    "imu": Request(Topic.IMU),
}


def pd_in_single_precision(given: Row) -> m.Four:
    """R2 computes in float: 0.225 · 1200 comes to less than 270 and is cut to 269."""
    names = ("q_des_rad", "q_rad", "kp", "torque_limit")
    goal, position, kp, limit = (np.array(given[name], dtype=np.float32) for name in names)
    a, b, c, d = map(float, np.clip(kp * (goal - position), -limit, limit))
    return a, b, c, d


def information(seen: Row) -> m.Information:
    """The drivers print the temperature's byte without the sign that the manual gives it, and name bit 2 otherwise."""
    bits = StatusBits.SERVO_ON * seen["servo_on"] | StatusBits.JOINT_HOT * seen["high_temperature_fault"]
    bits |= StatusBits.THROTTLED * seen["internal_communication_fault_per_code"]
    celsius = (seen["temperature_c"] + 128) % 256 - 128
    hardware, firmware = int(seen["hardware_version"], 16), int(seen["firmware_version"], 16)
    return m.Information(hardware, firmware, seen["hand"], celsius, StatusBits(bits))


BUILT: dict[str, Callable[[Row, Row, int], Message]] = {
    "torque": lambda given, _, finger: m.SetTorque(
        finger, tuple(given.get("torque_normalised_finger") or given["torque_finger"])
    ),
    "pd_position_command": lambda given, _, finger: m.SetTorque(finger, pd_in_single_precision(given)),
    "set_pose": lambda given, _, finger: m.SetPosition(finger, tuple(c * V4.rad_per_count for c in given["counts"])),
    "period": lambda given, _, __: m.SetPeriod(*(given[key] / 1000 for key in ("position_ms", "imu_ms", "temp_ms"))),
    "config_device_id": lambda given, _, __: m.Configure(device=given["new_device_id"]),
    "config_rs485_baud": lambda given, _, __: m.Configure(baud_rate=given["baudrate"]),
    "ahrs_set": lambda given, _, __: m.SetAhrs(given["rate_code"], given["mask"]),
    "rtr_pose": lambda _, __, finger: Request(Topic.POSITION, finger),
    "rtr_temperature": lambda _, __, finger: Request(Topic.TEMPERATURE, finger),
    "periodic_request": lambda given, _, __: (INFORMATION, SERIAL)[given["step"]],
    "position_rx": lambda _, seen, finger: m.FingerPosition(finger, tuple(seen["joint_rad"])),
    "temperature_rx": lambda _, seen, finger: m.FingerTemperature(finger, tuple(seen["temperature_c"])),
    "info_rx": lambda _, seen, __: information(seen),
    "serial_rx": lambda _, seen, __: m.Serial(seen["serial_ascii"].rstrip()),
}


@pytest.mark.parametrize(("version", "row"), ROWS)
def test_a_command_becomes_the_manufacturers_frame(version: str, row: Row) -> None:
    assert codec_of(version, row).encode(meaning(version, row)) == frame_of(row)


@pytest.mark.parametrize(("version", "row"), ROWS)
def test_the_manufacturers_frame_is_read_as_what_it_means(version: str, row: Row) -> None:
    codec = codec_of(version, row)
    read, meant = codec.decode(frame_of(row)), meaning(version, row)
    match read, meant:
        case m.FingerPosition(), m.FingerPosition():
            assert read.finger == meant.finger
            np.testing.assert_allclose(read.position, meant.position, rtol=0, atol=tolerance(row))
        case m.SetPosition(), m.SetPosition():
            assert read.finger == meant.finger
            np.testing.assert_allclose(read.position, meant.position, rtol=1e-12)
        case m.SetTorque(), m.SetTorque():
            assert read.finger == meant.finger
            lost = np.abs(meant.torque) - np.abs(read.torque)
            count = row["inputs"].get("torque_const", row["inputs"].get("const", 1200.0))
            saturated = np.abs(row["expected"]["int16_on_wire"]) == getattr(codec, "count_limit", None)
            assert (
                (lost > -1e-12) & (lost * count < 2.0) | saturated
            ).all()  # Two: a geared joint's counts are coarse.
            assert (np.sign(read.torque) * np.sign(meant.torque) >= 0).all()
        case _:
            assert read == meant


def tolerance(row: Row) -> float:
    number, unit = row["tolerance"].split()
    assert unit == "rad"
    return float(number)


@pytest.mark.parametrize(("version", "row"), ROWS)
def test_a_frame_that_was_read_is_said_again_bit_for_bit(version: str, row: Row) -> None:
    codec = codec_of(version, row)
    read = codec.decode(frame_of(row))
    assert read is not None
    assert codec.encode(read) == frame_of(row)


def test_the_rows_are_of_every_generation_and_direction() -> None:
    sizes = {version: len(rows) for version, rows in VECTORS.items()}
    assert sizes == {"v1": 10, "v2": 21, "v3": 21, "v4": 60, "v5": 38}
    for rows in VECTORS.values():
        assert {"position_rx", "torque_tx", "open_sequence_tx", "close_sequence_tx"} <= {row["kind"] for row in rows}
