"""A serial adapter that is not there: python-can's own slcan drives a hand through a pseudo-terminal."""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import can
import numpy as np
import pytest

from allegro_twin.types import TorqueCommand

if sys.platform == "win32":
    pytest.skip("Windows has no pseudo-terminals", allow_module_level=True)

from allegro_twin.drivers.can.virtual.slcan import SlcanDevice
from tests.conftest import can_config
from tests.drivers.can.rigs import Serving, driven, soon_limp

OPTIONS = {"sleep_after_open": 0.0}


@pytest.fixture
def tty(tmp_path: Path) -> Path:
    return tmp_path / "hand.tty"


def test_a_hand_is_driven_through_it_whole_and_in_real_time(tty: Path) -> None:
    with Serving(SlcanDevice(tty), can_config("v4")) as there:
        backend = driven("slcan", str(tty), options=OPTIONS)
        try:
            first = backend.reset()
            states = []
            for _ in range(100):
                backend.write(TorqueCommand(np.full(16, 0.02)))
                states.append(backend.read())
        finally:
            backend.close()
        assert states[-1].tick >= 100
        assert first.t == 0.0
        np.testing.assert_allclose(states[-1].torque, 0.02, atol=1 / 1200)
        assert soon_limp(there)
    assert not tty.exists()


def test_a_second_driver_finds_the_hand_that_a_first_one_left_without_a_word(tty: Path) -> None:
    with Serving(SlcanDevice(tty), can_config("v4")):
        crashed = os.open(tty, os.O_RDWR | os.O_NOCTTY)
        os.write(crashed, b"O\rt2046030000000000\rt1000\r")
        time.sleep(0.3)  # The hand reports to nobody; the terminal's buffer fills.
        os.close(crashed)
        backend = driven("slcan", str(tty), options=OPTIONS)
        try:
            assert backend.reset().tick == 0
            assert backend.read().tick >= 1
        finally:
            backend.close()


@pytest.fixture
def device(tty: Path) -> Iterator[SlcanDevice]:
    made = SlcanDevice(tty)
    yield made
    made.shutdown()


def said(tty: Path, device: SlcanDevice, *pieces: bytes) -> tuple[list[str], bytes]:
    """Frames that the device made of what a driver wrote, piece by piece, and what it answered."""
    line = os.open(tty, os.O_RDWR | os.O_NOCTTY)
    frames: list[str] = []
    try:
        for piece in pieces:
            os.write(line, piece)
            while (message := device.recv(0.02)) is not None:
                frames.append(
                    f"{message.arbitration_id:X}{'R' if message.is_remote_frame else '#'}{message.data.hex()}"
                )
        answer = os.read(line, 4096) if select.select([line], [], [], 0.2)[0] else b""
    finally:
        os.close(line)
    return frames, answer


def test_lines_may_come_in_pieces(tty: Path, device: SlcanDevice) -> None:
    assert said(tty, device, b"O\rt1", b"80", b"2AAbb", b"\rr080", b"0\r") == (["180#aabb", "80R"], b"\rz\rz\r")


@pytest.mark.parametrize(
    "line",
    [b"t", b"t18", b"t1809", b"t1802AA", b"t1802AABBCC", b"tXYZ0", b"t8001AA", b"t-120", b"t1801 A", b"r0809", b"q",
     b"\xff\xfe", b"S9", b"S", b"S5", b"T000001800", b"t1801\x00A"],
)  # fmt: skip
def test_what_is_no_line_is_refused_with_a_bell_and_the_next_is_heard(
    line: bytes, tty: Path, device: SlcanDevice
) -> None:
    assert said(tty, device, b"O\r", line + b"\r", b"t1001AA\r") == (["100#aa"], b"\r\az\r")


def test_a_flood_without_a_line_end_is_forgotten(tty: Path, device: SlcanDevice) -> None:
    frames, _ = said(tty, device, b"O\r", *[b"t" * 1000] * 5, b"\r", b"t1000\r")
    assert frames == ["100#"]
    assert all(len(adapter._buffer) < 100 for adapter in device._adapters.values())


def test_it_says_who_it_is_and_takes_the_bus_s_bitrate_alone(tty: Path, device: SlcanDevice) -> None:
    assert said(tty, device, b"V\rv\rN\rF\rS8\rC\r")[1].endswith(b"\r")
    assert said(tty, device, b"V\r")[1] == b"V1013\r"
    assert said(tty, device, b"S6\r")[1] == b"\a"


def test_a_closed_channel_hears_and_says_nothing(tty: Path, device: SlcanDevice) -> None:
    device.send(can.Message(arbitration_id=0x80, data=bytes(8), is_extended_id=False))
    assert said(tty, device, b"t1000\r") == ([], b"\a")


def test_a_driver_that_does_not_read_stops_nobody(tty: Path, device: SlcanDevice) -> None:
    assert said(tty, device, b"O\r")[1] == b"\r"
    line = os.open(tty, os.O_RDWR | os.O_NOCTTY)
    for k in range(5000):
        device.send(can.Message(arbitration_id=0x80, data=bytes([k % 256] * 8), is_extended_id=False))
    received = b""
    while select.select([line], [], [], 0.1)[0]:
        received += os.read(line, 65536)
    os.close(line)
    lines = received.split(b"\r")[:-1]
    assert 10 < len(lines) < 5000
    assert all(len(one) == len(b"t0808") + 16 for one in lines)  # Whole lines or none.
