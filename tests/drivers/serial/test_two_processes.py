"""A hand at a terminal in real time, driven through a real serial port; and what becomes of it when its driver dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("dynamixel_sdk", reason="pip install 'allegro-twin[dynamixel]'")
if sys.platform == "win32":
    pytest.skip("Windows has no pseudo-terminals", allow_module_level=True)

from allegro_twin.drivers.base.serial_port import SerialPort
from allegro_twin.drivers.base.terminal import Terminal
from allegro_twin.drivers.dynamixel.codec.packet import DynamixelPacket, Instruction, status
from allegro_twin.drivers.dynamixel.driver.backend import DynamixelBackend
from allegro_twin.drivers.dynamixel.driver.host_settings import ServoHostSettings
from allegro_twin.drivers.dynamixel.driver.line import SdkLine
from allegro_twin.drivers.dynamixel.virtual.hand import VirtualServoHand
from allegro_twin.errors import ConfigError, HandError, HandFault, LinkError, LinkTimeout
from allegro_twin.types import HandState, PositionCommand
from tests.drivers.keeper import ALL_THREE, DEATHS, end
from tests.drivers.serial.rigs import BAUD, MADE, Joints, Serving, calibrated, small_spec, soon

PERIOD = 0.02
PATIENCE = 1.0
"""s: a busy computer is no silent servo."""
ROOT = Path(__file__).resolve().parents[3]
DRIVER = """
import os, sys, time
import numpy as np
from pathlib import Path
from allegro_twin.types import HandState, PositionCommand
from tests.drivers.serial.test_two_processes import driven
backend = driven(Path(sys.argv[1]), keeper=sys.argv[2] != "none")
if sys.argv[2] == "forked" and os.fork() == 0:
    time.sleep(10.0)  # A child that outlives its parent, with all that was open.
    os._exit(0)
backend.reset()
said = False
while True:
    backend.write(PositionCommand(np.full(4, 0.5)))
    if backend.read().tick >= 20 and not said:
        said = print("driving", backend.keeper, flush=True) is None
"""

pytestmark = pytest.mark.realtime


def driven(path: Path, baud: int = BAUD, *, keeper: bool = False) -> DynamixelBackend:
    settings = ServoHostSettings(period=PERIOD, watchdog=0.5, keeper=keeper)
    made = DynamixelBackend(small_spec(), calibrated(), lambda: SerialPort(str(path), baud), settings, latency=PATIENCE)
    MADE.append(made)
    return made


@pytest.fixture
def tty(tmp_path: Path) -> Path:
    return tmp_path / "hand.tty"


@pytest.fixture
def hand(tty: Path) -> Iterator[VirtualServoHand]:
    made = VirtualServoHand(Joints(small_spec(), period=0.005), calibrated(), BAUD)
    with Serving(tty, made):
        yield made


def test_a_hand_is_driven_whole_and_in_real_time(hand: VirtualServoHand, tty: Path) -> None:
    backend = driven(tty)
    first = backend.reset()
    assert (first.t, first.tick) == (0.0, 0)
    begin, states = time.monotonic(), list[HandState]()
    while len(states) < 60 or (np.abs(states[-1].position - 0.5).max() > 0.05 and len(states) < 1000):
        backend.write(PositionCommand(np.full(4, 0.5)))
        states.append(backend.read())
    passed = time.monotonic() - begin
    backend.close()
    assert states[-1].t == pytest.approx(passed, abs=0.5)
    assert [state.tick for state in states] == sorted({state.tick for state in states})
    for state in states:
        assert state.t == pytest.approx(state.tick * PERIOD, abs=PERIOD / 2 + 1e-9)
    np.testing.assert_allclose(states[-1].position, 0.5, atol=0.05)
    assert soon(lambda: hand.limp)


def test_half_a_packet_before_a_pause_never_becomes_one(hand: VirtualServoHand, tty: Path) -> None:
    line, ping = SdkLine(SerialPort(str(tty), BAUD), 0.2), list(DynamixelPacket(3, Instruction.PING).encoded())
    try:

        def answered(pause: float) -> bool:
            line.clearPort()
            line.writePort(ping[:6])
            time.sleep(pause)
            line.writePort(ping[6:])
            line.setPacketTimeout(14)
            return bool(line.readPort(14))

        assert soon(lambda: answered(0.0))  # On a busy computer there can be a pause of its own.
        assert not answered(0.3)
        assert soon(lambda: answered(0.0))
    finally:
        line.port.close()


def test_a_second_program_cannot_open_the_port(hand: VirtualServoHand, tty: Path) -> None:
    driven(tty)
    with pytest.raises(LinkError, match=r"cannot open .*hand.tty: .*lock"):
        driven(tty)


def test_a_port_that_is_not_there_is_a_link_error_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match=r"cannot open .*nothing.tty: .*No such file") as caught:
        driven(tmp_path / "nothing.tty")
    assert "\n" not in str(caught.value)


def test_at_another_speed_it_says_which_one_answers(hand: VirtualServoHand, tty: Path) -> None:
    settings = ServoHostSettings(period=0.05, keeper=False)
    with pytest.raises(LinkTimeout, match="they answer at 1000000: set baud so"):
        DynamixelBackend(small_spec(), calibrated(), lambda: SerialPort(str(tty), 57_600), settings, latency=0.1)
    with pytest.raises(ConfigError, match="period 0.02 s is too short"):
        driven(tty, 9_600)


def test_a_program_that_hangs_is_stopped_by_the_servos_watchdogs(hand: VirtualServoHand, tty: Path) -> None:
    backend = driven(tty)
    backend.reset()
    for _ in range(5):
        backend.write(PositionCommand(np.full(4, 1.5)))
        backend.read()
    assert soon(lambda: all(servo.memory.get("bus_watchdog") == -1 for servo in hand.servos))
    there = hand.servos[0].memory.get("present_position")
    assert soon(lambda: abs(hand.servos[0].wants.goal - there) < 300)
    with pytest.raises(HandError, match=r"nobody called for|stopped by its bus watchdog"):
        backend.read()
    assert hand.limp


@pytest.fixture
def driver(hand: VirtualServoHand, tty: Path) -> Iterator[Callable[[str], tuple[subprocess.Popen[str], int]]]:
    """Starts a program that drives the hand; it and its keeper."""
    started: list[subprocess.Popen[str]] = []

    def start(how: str) -> tuple[subprocess.Popen[str], int]:
        started.append(
            subprocess.Popen([sys.executable, "-c", DRIVER, str(tty), how], cwd=ROOT, stdout=subprocess.PIPE, text=True)
        )
        assert started[-1].stdout is not None
        said = started[-1].stdout.readline().split()
        assert said[:1] == ["driving"]
        return started[-1], int(said[1])

    yield start
    for each in started:
        each.kill()
        each.wait()
        if each.stdout is not None:
            each.stdout.close()


Start = Callable[[str], tuple[subprocess.Popen[str], int]]


@pytest.mark.parametrize(
    ("kind", "how"), [("alone", signal.SIGKILL), ("alone", signal.SIGTERM), ("forked", signal.SIGKILL)]
)
def test_a_program_that_is_killed_leaves_the_hand_limp(
    hand: VirtualServoHand, driver: Start, kind: str, how: signal.Signals
) -> None:
    program, keeper = driver(kind)
    assert keeper
    assert not hand.limp
    program.send_signal(how)
    program.wait()
    assert soon(lambda: hand.limp)
    assert not any(servo.on for servo in hand.servos)
    assert soon(lambda: not Path(f"/proc/{keeper}").exists())


def test_a_program_that_ends_by_itself_leaves_the_hand_limp_and_no_keeper(
    hand: VirtualServoHand, driver: Start
) -> None:
    program, keeper = driver("alone")
    program.send_signal(signal.SIGINT)
    program.wait()
    assert hand.limp
    assert soon(lambda: not Path(f"/proc/{keeper}").exists())


@pytest.mark.parametrize("order", DEATHS)
def test_a_hand_whose_program_and_keeper_are_both_killed_is_limp(
    hand: VirtualServoHand, driver: Start, order: str
) -> None:
    """Limp, and not only stopped by the servos' own watchdogs."""
    program, keeper = driver("alone")
    assert not hand.limp
    finish = end(DEATHS[order], program, keeper, 0.002)
    assert soon(lambda: hand.limp)
    finish()


def test_killed_with_its_keeper_and_the_second_the_servos_stop_where_they_are(
    hand: VirtualServoHand, driver: Start
) -> None:
    """What a real servo's watchdog does as well: it stops, and holds with the current that it was allowed."""
    end(ALL_THREE, *driver("alone"), 0.0)
    assert soon(lambda: all(servo.memory.get("bus_watchdog") == -1 for servo in hand.servos))
    assert all(servo.on for servo in hand.servos)
    assert {servo.wants.current for servo in hand.servos} == {calibrated().current_counts[0]}


def test_a_keeper_that_was_ended_is_a_fault_and_reset_starts_another(hand: VirtualServoHand, tty: Path) -> None:
    backend = driven(tty, keeper=True)
    backend.reset()
    os.kill(backend.keeper, signal.SIGKILL)
    with pytest.raises(HandFault, match="the keeper of this hand has ended"):
        for _ in range(200):
            backend.write(PositionCommand(np.full(4, 0.2)))
            backend.read()
    assert hand.limp
    backend.reset()
    assert Path(f"/proc/{backend.keeper}").exists()


def test_a_stranger_that_never_stops_speaking_is_an_error_and_not_for_ever(tmp_path: Path) -> None:
    terminal, over = Terminal(tmp_path / "line.tty"), threading.Event()
    chatter = status(99, 0, bytes(10)).encoded() * 20

    def speak() -> None:
        while not over.is_set():
            if not terminal.write(chatter):
                over.wait(0.0005)

    speaker = threading.Thread(target=speak, daemon=True)
    speaker.start()
    try:
        with pytest.raises(HandError):
            driven(tmp_path / "line.tty")
    finally:
        over.set()
        speaker.join()
        terminal.close()


def test_a_leap_hand_in_one_program_is_driven_by_another(tmp_path: Path) -> None:
    config, tty = tmp_path / "leap.yaml", tmp_path / "leap.tty"
    block = f"{{kind: dynamixel, port: {tty}, baud: 4000000, latency: 1.0, watchdog: 2.0}}"
    config.write_text(f"hand: {{model: leap}}\nbackend: {block}\ntask: {{posture: leap_home}}\nperiod: 0.05\n"
                      "controller: {kind: position}\nseconds: 3.0\n")  # fmt: skip
    command = [sys.executable, "-m", "allegro_twin"]
    wide = {**os.environ, "COLUMNS": "200"}
    with subprocess.Popen([*command, "firmware", str(config)], cwd=ROOT, stdout=subprocess.PIPE, text=True) as there:
        assert soon(tty.exists, 60.0)
        done = subprocess.run([*command, "run", str(config)], cwd=ROOT, env=wide, capture_output=True, text=True)
        there.send_signal(signal.SIGINT)
        said, _ = there.communicate()
    assert done.returncode == 0, done.stderr
    assert "leap_right at " in done.stdout
    assert "leap_right at" in said
    assert "bytes heard" in said
    assert not tty.exists()


def test_a_terminal_that_cannot_be_made_is_a_link_error(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="cannot put a terminal at"):
        Terminal(tmp_path / "no" / "such" / "folder")
