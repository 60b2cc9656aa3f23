"""A hand on SocketCAN, as most people will come to it."""

from __future__ import annotations

import os
import signal
import socket
import struct
import time
from pathlib import Path

import pytest

from allegro_twin.recording.reader import load
from tests.patience import comes_true
from tests.socketcan.inside.rigs import (
    PERIOD,
    assert_recorded,
    command,
    config,
    delayed,
    ear,
    exit_code,
    forked,
    hand_on,
    ip,
    said_until_quiet,
)

TIMES = range(int(os.environ.get("TIMES", "1")))
"""How often what leaves the hand limp is tried."""
PAIRS = [("vcan0", "vcan0"), ("vxcan0", "vxcan1")]
"""Where the driver is, and the hand: on one interface of one computer, or at both ends of a cable."""
TORQUES, SERVO_OFF, PERIODS = (0x180, 0x184, 0x188, 0x18C), 0x104, 0x204


@pytest.mark.parametrize("time_", TIMES)
@pytest.mark.parametrize(("here", "there"), PAIRS)
def test_a_hand_is_driven_and_limp_after_the_command(here: str, there: str, time_: int, tmp_path: Path) -> None:
    recording = tmp_path / "run.arrow"
    with (
        hand_on(there) as hand,
        forked(command("run", config(tmp_path, here, deadman=1.0), "--seconds", 1, "--record", recording)) as run,
    ):
        assert comes_true(lambda: hand.pushes, 40.0)
        assert exit_code(run) == 0
        assert hand.seen.limp_since
        assert not hand.seen.serving
    assert_recorded(recording)


@pytest.mark.parametrize(("here", "there"), PAIRS)
def test_another_program_on_the_same_computer_is_noticed(here: str, there: str, tmp_path: Path) -> None:
    path = config(tmp_path, here, deadman=1.0)
    with hand_on(there) as hand, forked(command("run", path)) as first:
        assert comes_true(lambda: hand.pushes, 40.0)
        with forked(command("run", path, "--seconds", 1)) as second:
            assert exit_code(first) == 3
            assert exit_code(second) in (0, 3)
        assert comes_true(lambda: bool(hand.seen.limp_since), 20.0)


@pytest.mark.parametrize("time_", TIMES)
@pytest.mark.parametrize(("here", "there"), PAIRS)
def test_a_killed_program_leaves_the_hand_limp(here: str, there: str, time_: int, tmp_path: Path) -> None:
    with hand_on(there) as hand, forked(command("run", config(tmp_path, here))) as run:
        assert comes_true(lambda: hand.pushes, 40.0)
        time.sleep(0.3)
        os.kill(run, signal.SIGKILL)
        killed = time.monotonic()
        assert comes_true(lambda: bool(hand.seen.limp_since), 20.0)
        assert hand.seen.limp_since - killed < 1.0


@pytest.mark.parametrize("time_", TIMES)
def test_stale_torques_of_a_full_queue_are_not_the_last_words(time_: int, tmp_path: Path) -> None:
    """For a second every frame is under way, and ten of them fill the queue; then all arrive."""
    path = config(tmp_path, "vxcan0", deadman=1.0)
    with hand_on("vxcan1") as hand, ear("vxcan1") as heard, forked(command("run", path)) as run:
        assert comes_true(lambda: hand.pushes, 40.0)
        with delayed("vxcan0", "delay", "1s", "limit", "10"):
            assert exit_code(run) == 3
            assert comes_true(lambda: bool(hand.seen.limp_since), 20.0)
        frames = [frame for frame in said_until_quiet(heard) if frame[0] in (*TORQUES, SERVO_OFF, PERIODS)]
    assert frames[-1] == (PERIODS, bytes(6))
    for identifier in TORQUES:
        assert [data for known, data in frames if known == identifier][-1] == bytes(8)


@pytest.mark.parametrize("time_", TIMES)
def test_an_interface_that_was_down_carries_the_last_words_as_soon_as_it_is_up(time_: int, tmp_path: Path) -> None:
    with hand_on("vxcan1") as hand, forked(command("run", config(tmp_path, "vxcan0", deadman=1.0))) as run:
        assert comes_true(lambda: hand.pushes, 40.0)
        ip("link", "set", "vxcan0", "down")
        assert exit_code(run) == 3
        assert hand.pushes
        ip("link", "set", "vxcan0", "up")
        back = time.monotonic()
        assert comes_true(lambda: bool(hand.seen.limp_since), 20.0)
        assert hand.seen.limp_since - back < 0.5


@pytest.mark.parametrize("hours", [1, -1])
def test_a_clock_that_is_set_moves_no_time_of_the_hand(hours: int, tmp_path: Path) -> None:
    recording = tmp_path / "run.arrow"
    with (
        hand_on("vcan0") as hand,
        forked(command("run", config(tmp_path, "vcan0", deadman=1.0), "--seconds", 3, "--record", recording)) as run,
    ):
        assert comes_true(lambda: hand.pushes, 40.0)
        time.sleep(0.5)
        began = time.monotonic()
        time.clock_settime(time.CLOCK_REALTIME, time.time() + 3600.0 * hours)
        assert exit_code(run) == 0
        lasted = time.monotonic() - began
    times = load(recording).columns["t"].astype(float)
    assert 2.0 < lasted < 6.0
    assert times[-1] == pytest.approx(3.0, abs=2 * PERIOD)
    assert (times[1:] - times[:-1]).max() < 0.5


@pytest.mark.parametrize(
    ("identifier", "data", "code"), [(0x20000040, bytes(8), 3), (0x20000004, b"\0\1" + bytes(6), 0)]
)
def test_error_frames_end_a_session_only_when_the_bus_is_off(
    identifier: int, data: bytes, code: int, tmp_path: Path
) -> None:
    """linux/can/error.h: CAN_ERR_BUSOFF; CAN_ERR_CRTL with an overflow of the receiver."""
    with (
        hand_on("vcan0") as hand,
        forked(command("run", config(tmp_path, "vcan0", deadman=1.0), "--seconds", 1)) as run,
    ):
        assert comes_true(lambda: hand.pushes, 40.0)
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as raw:
            raw.bind(("vcan0",))
            raw.send(struct.pack("=IB3x8s", identifier, 8, data))
        assert exit_code(run) == code
        assert comes_true(lambda: bool(hand.seen.limp_since), 20.0)


def test_sniff_and_check_work_beside_and_after_a_driver(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = config(tmp_path, "vcan0", deadman=1.0)
    with hand_on("vcan0") as hand:
        with forked(command("run", path)) as run:
            assert comes_true(lambda: hand.pushes, 40.0)
            with forked(command("sniff", path, "--seconds", 0.5, "--lines")) as sniff:
                assert exit_code(sniff) == 0
            assert hand.pushes
            os.kill(run, signal.SIGHUP)
            assert exit_code(run) == 128 + signal.SIGHUP
        assert "torque index" in capfd.readouterr().out
        with forked(command("check", path)) as check:
            assert exit_code(check, 60.0) == 0
        assert not hand.seen.serving
