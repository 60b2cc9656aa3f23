"""Hands that answer at a terminal in real time, driven through a real serial port; and what becomes of them when their
driver dies."""

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

if sys.platform == "win32":
    pytest.skip("Windows has no pseudo-terminals", allow_module_level=True)

from allegro_twin.drivers.base.serial_port import SerialPort
from allegro_twin.drivers.base.terminal import Terminal
from allegro_twin.drivers.dynamixel.codec.packet import status
from allegro_twin.drivers.polled.backend import PolledBackend
from allegro_twin.drivers.polled.device import VirtualPolledHand
from allegro_twin.drivers.polled.host_settings import PolledHostSettings
from allegro_twin.errors import ConfigError, HandError, HandFault, LinkError, LinkTimeout
from allegro_twin.types import HandState, PositionCommand
from tests.drivers.keeper import ALL_THREE, end
from tests.drivers.serial.polled_rigs import BAUD, KINDS, MOTORS, Kind, scale_of, spec_of, virtual, wire_of
from tests.drivers.serial.rigs import MADE, Serving, soon

PERIOD = 0.02
PATIENCE = 1.0
"""s: a busy computer is no silent hand."""
ROOT = Path(__file__).resolve().parents[3]
DRIVER = """
import os, sys, time
import numpy as np
from pathlib import Path
from allegro_twin.types import PositionCommand
from tests.drivers.serial.test_polled_two_processes import driven
backend = driven(sys.argv[3], Path(sys.argv[1]), keeper=True)
if sys.argv[2] == "forked" and os.fork() == 0:
    time.sleep(10.0)  # A child that outlives its parent, with all that was open.
    os._exit(0)
backend.reset()
said = False
while True:
    backend.write(PositionCommand(np.full(backend.spec.n_actuators, 0.5)))
    if backend.read().tick >= 20 and not said:
        said = print("driving", backend.keeper, flush=True) is None
"""

pytestmark = pytest.mark.realtime


def driven(kind: Kind, path: Path, baud: int | None = None, *, keeper: bool = False) -> PolledBackend:
    settings = PolledHostSettings(PERIOD, watchdog=0.5, latency=PATIENCE, keeper=keeper)
    made = PolledBackend(
        spec_of(kind),
        scale_of(kind),
        lambda: SerialPort(str(path), baud or BAUD[kind]),
        wire_of(kind, settings),
        settings,
    )
    MADE.append(made)
    return made


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> Kind:
    found: Kind = request.param
    return found


@pytest.fixture
def tty(tmp_path: Path) -> Path:
    return tmp_path / "hand.tty"


@pytest.fixture
def hand(tty: Path, kind: Kind) -> Iterator[VirtualPolledHand]:
    made = virtual(kind, period=0.005)
    with Serving(tty, made):
        yield made


def test_a_hand_is_driven_whole_and_in_real_time(hand: VirtualPolledHand, tty: Path, kind: Kind) -> None:
    backend = driven(kind, tty)
    first = backend.reset()
    assert (first.t, first.tick) == (0.0, 0)
    begin, states = time.monotonic(), list[HandState]()
    while len(states) < 60 or (np.abs(states[-1].position - 0.5).max() > 0.05 and len(states) < 1000):
        backend.write(PositionCommand(np.full(MOTORS[kind], 0.5)))
        states.append(backend.read())
    passed = time.monotonic() - begin
    backend.close()
    assert states[-1].t == pytest.approx(passed, abs=0.5)
    assert [state.tick for state in states] == sorted({state.tick for state in states})
    np.testing.assert_allclose(states[-1].position, 0.5, atol=0.05)
    assert soon(lambda: hand.limp)


def test_a_second_program_cannot_open_the_port(hand: VirtualPolledHand, tty: Path, kind: Kind) -> None:
    driven(kind, tty)
    with pytest.raises(LinkError, match=r"cannot open .*hand.tty: .*lock"):
        driven(kind, tty)


def test_a_port_that_is_not_there_is_a_link_error_in_one_line(tmp_path: Path, kind: Kind) -> None:
    with pytest.raises(LinkError, match=r"cannot open .*nothing.tty: .*No such file") as caught:
        driven(kind, tmp_path / "nothing.tty")
    assert "\n" not in str(caught.value)


def test_at_another_speed_it_says_which_one_answers(hand: VirtualPolledHand, tty: Path, kind: Kind) -> None:
    settings = PolledHostSettings(PERIOD, latency=0.1, keeper=False)
    with pytest.raises(LinkTimeout, match=f"at 57600 baud; it answers at {BAUD[kind]}: set backend.baud so"):
        PolledBackend(
            spec_of(kind), scale_of(kind), lambda: SerialPort(str(tty), 57_600), wire_of(kind, settings), settings
        )


def test_another_hand_that_never_stops_speaking_is_named_and_not_for_ever(tmp_path: Path, kind: Kind) -> None:
    terminal, over = Terminal(tmp_path / "line.tty"), threading.Event()
    chatter = status(99, 0, bytes(10)).encoded() * 20

    def speak() -> None:
        while not over.is_set():
            if not terminal.write(chatter):
                over.wait(0.0005)

    speaker = threading.Thread(target=speak, daemon=True)
    speaker.start()
    try:
        with pytest.raises(ConfigError, match="speaks a DYNAMIXEL servo"):
            driven(kind, tmp_path / "line.tty")
    finally:
        over.set()
        speaker.join()
        terminal.close()


def test_a_program_that_hangs_is_left_by_the_hand_itself(hand: VirtualPolledHand, tty: Path, kind: Kind) -> None:
    backend = driven(kind, tty)
    backend.reset()
    for _ in range(5):
        backend.write(PositionCommand(np.full(MOTORS[kind], 1.5)))
        backend.read()
    assert soon(lambda: hand.limp)
    with pytest.raises(HandError, match=r"nobody called for|heard nobody in time|switched off, by its watchdog"):
        for _ in range(20):  # A qb device is asked in every tenth period.
            backend.read()
    assert hand.limp


Start = Callable[[str], tuple[subprocess.Popen[str], int]]


@pytest.fixture
def driver(hand: VirtualPolledHand, tty: Path, kind: Kind) -> Iterator[Start]:
    """Starts a program that drives the hand; it and its keeper."""
    started: list[subprocess.Popen[str]] = []

    def start(how: str) -> tuple[subprocess.Popen[str], int]:
        command = [sys.executable, "-c", DRIVER, str(tty), how, kind]
        started.append(subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True))
        assert started[0].stdout is not None
        said = started[0].stdout.readline().split()
        assert said[:1] == ["driving"]
        return started[0], int(said[1])

    yield start
    for each in started:
        each.kill()
        each.wait()
        if each.stdout is not None:
            each.stdout.close()


@pytest.mark.parametrize(
    ("how", "what"), [("alone", signal.SIGKILL), ("alone", signal.SIGTERM), ("forked", signal.SIGKILL)]
)
def test_a_program_that_is_killed_leaves_the_hand_limp(
    hand: VirtualPolledHand, driver: Start, how: str, what: signal.Signals
) -> None:
    program, keeper = driver(how)
    assert keeper
    assert not hand.limp
    program.send_signal(what)
    program.wait()
    assert soon(lambda: hand.limp)
    assert soon(lambda: not Path(f"/proc/{keeper}").exists())


def test_a_program_that_ends_by_itself_leaves_the_hand_limp_and_no_keeper(
    hand: VirtualPolledHand, driver: Start
) -> None:
    program, keeper = driver("alone")
    program.send_signal(signal.SIGINT)
    program.wait()
    assert hand.limp
    assert soon(lambda: not Path(f"/proc/{keeper}").exists())


def test_killed_with_its_keeper_and_the_second_the_hands_own_watchdog_lets_go(
    hand: VirtualPolledHand, driver: Start
) -> None:
    end(ALL_THREE, *driver("alone"), 0.0)
    assert soon(lambda: hand.limp)


def test_a_keeper_that_was_ended_is_a_fault_and_reset_starts_another(
    hand: VirtualPolledHand, tty: Path, kind: Kind
) -> None:
    backend = driven(kind, tty, keeper=True)
    backend.reset()
    os.kill(backend.keeper, signal.SIGKILL)
    with pytest.raises(HandFault, match="the keeper of this hand has ended"):
        for _ in range(200):
            backend.write(PositionCommand(np.full(MOTORS[kind], 0.2)))
            backend.read()
    assert hand.limp
    backend.reset()
    assert Path(f"/proc/{backend.keeper}").exists()


@pytest.mark.parametrize(("model", "said"), [("qb_softhand", "qb at 2000000"), ("sih", "schunk at 1000000")])
def test_a_hand_in_one_program_is_driven_by_another(tmp_path: Path, model: str, said: str) -> None:
    config, tty = tmp_path / "hand.yaml", tmp_path / "hand.tty"
    block = f"{{kind: {said.split()[0]}, port: {tty}, latency: 1.0, watchdog: 2.0}}"
    config.write_text(f"hand: {{model: {model}}}\nbackend: {block}\nperiod: 0.05\n"
                      "controller: {kind: position}\nseconds: 2.0\n")  # fmt: skip
    command = [sys.executable, "-m", "allegro_twin"]
    wide = {**os.environ, "COLUMNS": "200"}
    with subprocess.Popen([*command, "firmware", str(config)], cwd=ROOT, stdout=subprocess.PIPE, text=True) as there:
        assert soon(tty.exists, 60.0)
        done = subprocess.run([*command, "run", str(config)], cwd=ROOT, env=wide, capture_output=True, text=True)
        there.send_signal(signal.SIGINT)
        told, _ = there.communicate()
    assert done.returncode == 0, done.stderr
    assert f"{model}_right at 2." in " ".join(done.stdout.split())
    assert said in told
    assert "bytes heard" in told
    assert not tty.exists()
