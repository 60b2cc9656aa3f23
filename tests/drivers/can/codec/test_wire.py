"""The wire of every version is what it was: hands and logs out there speak it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.messages import Message, Request, StatusBits, Topic
from allegro_twin.errors import ProtocolError
from tests.drivers.can.strategies import HANDS, KNOWN
from tests.snapshots import assert_snapshot

MESSAGES: tuple[Message, ...] = (
    m.ServoOn(), m.ServoOff(), m.SetMode(False), m.SetMode(True), m.Pick(), m.Place(), m.Calibrate(),
    m.CalibrationDone(),
    *(m.SetTorque(finger, (0.1, -0.2, 0.05, 0.7)) for finger in range(4)),
    *(m.SetPosition(finger, (0.1, -0.2, 0.3, 1.5)) for finger in range(4)),
    m.SetPeriod(0.003), m.SetPeriod(0.003, 0.02, 0.5), m.SetPeriod(0.01, status=1.0),
    m.SetAhrs(4, 3), m.Ahrs(1, (1, -2, 3)), m.Configure(2, 3), m.Configure(device=1), m.Configure(baud_rate=2),
    *(Request(topic) for topic in Topic),
    *(Request(topic, finger) for topic in Topic for finger in (0, 3)),
    *(m.FingerPosition(finger, (0.1, -0.2, 0.3, 1.5)) for finger in range(4)),
    *(m.FingerTemperature(finger, (25.0, 30.0, 45.0, 61.0)) for finger in range(4)),
    m.Imu((0.5, -0.5, 0.5, 0.5)), *(m.Status(bit) for bit in StatusBits),
    m.Information(0x102, 0x304, "right", 31.0), m.Information(0x102, 0x304, "left", 31.0),
    m.Information(0x102, 0x304, None, bits=StatusBits(5)),
    m.Serial("5TBR0017"), m.Serial("SAH040AR012"),
    m.FingertipPressure((0, 1), (1000.0, -2.0)), m.FingertipPressure((2, 3), (70000.0, 0.4)),
    m.MotorError(7, True, False, False, True), m.MotorError(15, False, True, True, False),
)  # fmt: skip


def shortly(message: object) -> str:
    """With numbers to the digits that every computer has."""
    return re.sub(r"\d+\.\d{7,}(e-\d+)?", lambda found: f"{float(found[0]):.9g}", str(message))


@pytest.mark.parametrize("name", HANDS)
def test_every_message_is_the_frame_that_it_was(name: str) -> None:
    """What is known of the manufacturer's own frames stands in test_golden.py; here all are kept."""
    codec, lines = HANDS[name], []
    for message in MESSAGES:
        try:
            frame = codec.encode(message)
        except ProtocolError as error:
            lines.append(f"{message}: {error}")
            continue
        lines.append(f"{message}: {frame.id:03x} {frame.data.hex()} {'remote' if frame.remote else ''}".rstrip())
        try:
            lines.append(f"    read as {shortly(codec.decode(frame))}")
        except ProtocolError as error:
            lines.append(f"    {error}")
    assert_snapshot("\n".join(lines), Path(__file__).with_name("snapshots") / f"{name.replace(' ', '_')}.txt")


@pytest.mark.parametrize("name", HANDS)
def test_a_hand_listens_to_the_identifiers_to_which_it_did(name: str) -> None:
    heard = " ".join(f"{identifier:03x}" for identifier in KNOWN[name])
    assert_snapshot(heard, Path(__file__).with_name("snapshots") / f"{name.replace(' ', '_')}_heard.txt")
