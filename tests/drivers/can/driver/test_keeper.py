"""Whatever becomes of the program that drives a hand, the hand is limp: benchmarks/deaths.py has the figures."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import numpy as np
import pytest

from allegro_twin.app import assemble
from allegro_twin.app.config import load_config
from allegro_twin.drivers.base.keeper.keeper import Keeper
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.errors import HandFault, LinkError
from allegro_twin.surfaces.hand import Hand
from allegro_twin.types import TorqueCommand
from benchmarks.deaths import INSIDE, LINKS, SOON, Link, Served, died, served, ways
from tests.conftest import can_config
from tests.drivers.can.rigs import Serving
from tests.drivers.can.rigs import driven as driven_on
from tests.drivers.keeper import DEATHS, end, second_of
from tests.patience import comes_true

BUSY = 3.0 * SOON / 1000.0
"""s: a machine that tests in parallel is slower than one that is measured."""

pytestmark = pytest.mark.realtime


@pytest.fixture(params=LINKS)
def hand(request: pytest.FixtureRequest) -> Iterator[Served]:
    with served(request.param) as there:
        yield there


@pytest.fixture
def driven(hand: Served) -> Iterator[CanBackend]:
    """A backend that drives the hand."""
    backend = assemble(load_config(hand.path)).driver
    assert isinstance(backend, CanBackend)
    at_work(backend)
    yield backend
    backend.close()


def at_work(backend: CanBackend) -> None:
    backend.reset()
    for _ in range(10):
        backend.write(TorqueCommand(np.full(16, 0.05)))
        backend.read()


def soon(condition: Callable[[], bool]) -> bool:
    return comes_true(condition)


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize(
    ("way", "library"),
    [
        ("KILL", False),
        ("hang", True),
        ("HUP", False),
        *(pytest.param(way, True, marks=pytest.mark.long) for way in ("STOP", "TERM")),
    ],
)
def test_a_hand_whose_program_dies_is_limp_soon(link: Link, way: str, library: bool) -> None:
    with served(link) as hand:
        assert died(hand, way, library=library) < BUSY


@pytest.mark.long
@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize(("way", "library"), list(ways()))
def test_every_way_to_die_leaves_the_hand_limp_twenty_times(link: Link, way: str, library: bool) -> None:
    with served(link) as hand:
        assert all(died(hand, way, library=library) < BUSY for _ in range(20))


def test_ends_are_confirmed_by_the_hand_itself(hand: Served, driven: CanBackend) -> None:
    assert hand.pushes
    driven.close()
    assert not hand.pushes
    assert driven.unconfirmed == ""


@pytest.mark.long
def test_a_hundred_ends_in_a_row_leave_the_hand_limp(hand: Served) -> None:
    backend = assemble(load_config(hand.path)).driver
    assert isinstance(backend, CanBackend)
    for _ in range(100):
        at_work(backend)
        backend.close()
        assert not hand.pushes
        assert backend.unconfirmed == ""


def test_a_program_that_comes_back_from_a_stall_sends_no_torque_and_says_why(driven: CanBackend, hand: Served) -> None:
    time.sleep(0.9)
    assert not hand.pushes
    with pytest.raises(HandFault, match=r"nobody called for 0\.3 s, so the hand was cut off; reset to go on"):
        driven.write(TorqueCommand(np.full(16, 0.05)))
    time.sleep(0.1)
    assert not hand.pushes
    assert not any(hand.firmware.torque)
    at_work(driven)
    assert hand.pushes


def test_a_hand_that_does_not_confirm_is_named_in_the_error_and_its_keeper_goes_on(
    hand: Served, driven: CanBackend
) -> None:
    """It hears nothing for a while, as one at the other end of a cable that is out."""
    receive, hand.hands.receive = hand.hands.receive, lambda frame: []  # type: ignore[method-assign]
    driven.close()
    assert "the hand has not confirmed that it is limp (it does not answer): its keeper goes on" in driven.unconfirmed
    assert hand.pushes
    hand.hands.receive = receive  # type: ignore[method-assign]
    assert soon(lambda: not hand.pushes)


def test_hand_raises_when_it_was_not_confirmed(hand: Served) -> None:
    receive = hand.hands.receive
    with pytest.raises(LinkError, match="has not confirmed that it is limp"), Hand.open(hand.path) as opened:
        opened.set_controller("torque", torque=0.05)
        opened.wait(0.1)
        hand.hands.receive = lambda frame: []  # type: ignore[method-assign]
    hand.hands.receive = receive  # type: ignore[method-assign]
    assert soon(lambda: not hand.pushes)


def test_without_its_keeper_no_hand_is_driven(driven: CanBackend) -> None:
    """Somebody ended it."""
    keeper = driven._watch._guard
    assert isinstance(keeper, Keeper)
    os.kill(keeper.process, signal.SIGKILL)
    with pytest.raises(HandFault, match="the keeper of this hand has ended, and nobody would leave it limp"):
        for _ in range(2000):
            driven.write(TorqueCommand(np.zeros(16)))
            driven.read()
    at_work(driven)


DRIVER = """
import sys
import numpy as np
from allegro_twin.app import assemble
from allegro_twin.app.config import load_config
from allegro_twin.types import TorqueCommand
backend = assemble(load_config(sys.argv[1])).driver
backend.reset()
for k in range(100_000):
    backend.write(TorqueCommand(np.full(16, 0.05)))
    backend.read()
    if k == 20:
        print(backend.keeper, flush=True)
"""


@pytest.mark.parametrize("order", DEATHS)
def test_a_hand_whose_program_and_keeper_are_both_killed_is_limp(hand: Served, order: str) -> None:
    for between in (0.0, 0.002, 0.05):
        command = [sys.executable, "-c", DRIVER, str(hand.path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
            assert program.stdout is not None
            keeper = int(program.stdout.readline())
            assert hand.pushes
            finish = end(DEATHS[order], program, keeper, between)
            assert soon(lambda: not hand.pushes), between
            finish()


def test_a_second_that_is_killed_is_replaced_and_none_outlives_its_keeper(driven: CanBackend) -> None:
    first = second_of(driven.keeper)
    os.kill(first, signal.SIGKILL)
    assert soon(lambda: not Path(f"/proc/{first}").exists() and second_of(driven.keeper) != first)
    keeper, second = driven.keeper, second_of(driven.keeper)
    driven.close()
    assert soon(lambda: not Path(f"/proc/{keeper}").exists() and not Path(f"/proc/{second}").exists())


def test_after_a_suspend_the_hand_is_limp_and_the_error_says_so(
    driven: CanBackend, hand: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock that counts a suspend has run ahead of the one that does not."""
    clock, slept = time.clock_gettime, 12.3
    monkeypatch.setattr(time, "clock_gettime", lambda which: clock(which) + slept * (which == time.CLOCK_BOOTTIME))
    with pytest.raises(HandFault, match=r"this computer was suspended for 12\.3 s while it drove the hand"):
        driven.read()
    assert soon(lambda: not hand.pushes)
    at_work(driven)  # What was before a reset is forgotten.
    assert hand.pushes


def test_the_computer_is_asked_not_to_sleep_while_a_hand_is_driven(
    hand: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a program in place of systemd-inhibit that writes down what it is asked."""
    asked, fake = tmp_path / "asked", tmp_path / "systemd-inhibit"
    fake.write_text(f'#!/bin/sh\necho "$@" > {asked}\nexec cat\n')
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    backend = assemble(load_config(hand.path)).driver
    assert isinstance(backend, CanBackend)
    at_work(backend)
    inhibitor = backend._watch._inhibitor
    assert inhibitor is not None
    assert inhibitor.holds
    assert soon(lambda: asked.exists() and "--what=sleep:handle-lid-switch" in asked.read_text())
    backend.close()
    assert not inhibitor.holds


def test_a_keeper_hears_no_signal_that_is_meant_for_the_program(driven: CanBackend, hand: Served) -> None:
    """Ctrl-C and the end of a terminal reach the whole group, and a service manager tells every process to end."""
    keeper = driven._watch._guard
    assert isinstance(keeper, Keeper)
    assert os.getsid(keeper.process) != os.getsid(0)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        os.kill(keeper.process, number)
    time.sleep(0.05)
    assert keeper.alive


def test_without_a_keeper_a_thread_cuts_off_a_program_that_stalls(hand: Served) -> None:
    config = load_config(hand.path)
    backend = assemble(
        config.model_copy(update={"backend": config.backend.model_copy(update={"keeper": False})})
    ).driver
    assert isinstance(backend, CanBackend)
    at_work(backend)
    assert not [line for line in backend.warnings() if "keeper" in line]  # It was not wanted.
    time.sleep(0.9)
    assert not hand.pushes
    with pytest.raises(HandFault, match="nobody called"):
        backend.read()
    backend.close()


def test_a_link_that_cannot_be_shared_says_so() -> None:
    with Serving(can.Bus(interface="virtual", channel="alone", ignore_config=True), can_config("v4")):
        backend = driven_on("virtual", "alone", deadman=0.5)
        backend.reset()
        assert backend.warnings() == [
            "no keeper: this adapter serves one program at a time; a crash of this program leaves the hand pushing"
        ]
        backend.close()


def test_every_way_inside_a_program_is_tried() -> None:
    assert {way for way, library in ways() if library} >= set(INSIDE)
