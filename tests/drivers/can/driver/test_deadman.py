"""A hand keeps its last torque for ever, so a program that no longer commands it is cut off.

Bounds are wide, for the machine may be busy; benchmarks/deadman.py has the figures.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import can
import numpy as np
import pytest

from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.can.driver.deadman import Deadman
from allegro_twin.errors import HandFault
from allegro_twin.types import TorqueCommand
from tests.conftest import can_config, on_a_bus
from tests.drivers.can.rigs import Serving, driven

PATIENCE = 0.1

pytestmark = pytest.mark.realtime


@pytest.fixture
def there() -> Iterator[Serving]:
    bus = can.Bus(interface="virtual", channel="deadman", ignore_config=True)
    with Serving(bus, can_config("v4")) as serving:
        yield serving


def sleep() -> None:
    time.sleep(0.6)


def spin() -> None:
    deadline = time.monotonic() + 0.6
    while time.monotonic() < deadline:
        sum(range(1000))


def at_work(backend: CanBackend) -> None:
    backend.reset()
    for _ in range(20):
        backend.write(TorqueCommand(np.full(16, 0.05)))
        backend.read()


@pytest.mark.parametrize("hang", [sleep, spin], ids=["sleeps", "spins in Python"])
def test_a_hand_whose_program_hangs_is_limp_soon(hang: Callable[[], None], there: Serving) -> None:
    backend, hand = driven("virtual", "deadman", deadman=PATIENCE), there.firmwares[0]
    cut: list[float] = []

    def watch() -> None:
        while not cut and time.monotonic() - began < 5.0:
            if not hand.serving:
                cut.append(time.monotonic() - began)
            time.sleep(0.002)

    try:
        at_work(backend)
        assert hand.state.torque.any()
        began = time.monotonic()
        watching = threading.Thread(target=watch)
        watching.start()
        hang()
        watching.join()
        assert PATIENCE * 0.7 < cut[0] < 0.55  # Before the program came back.
        for call in (backend.read, lambda: backend.write(TorqueCommand(np.zeros(16)))):
            with pytest.raises(HandFault, match=r"nobody called for 0\.1 s, so the hand was cut off; reset to go on"):
                call()
        assert backend.reset().tick == 0
        assert backend.read().tick >= 1
    finally:
        backend.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "deadman"]


def test_it_leaves_a_program_alone_that_calls_in_time(there: Serving) -> None:
    backend = driven("virtual", "deadman", deadman=1.0)
    try:
        at_work(backend)
        for _ in range(3):
            time.sleep(0.1)
            backend.write(TorqueCommand(np.zeros(16)))
        assert there.firmwares[0].serving
    finally:
        backend.close()


def test_on_a_lockstep_bus_time_stands_still_and_nothing_watches() -> None:
    backend = on_a_bus("v4", deadman=0.02)
    backend.reset()
    time.sleep(0.1)
    assert backend.read().tick == 1
    backend.close()


def test_after_close_nothing_is_sent_any_more(there: Serving) -> None:
    backend = driven("virtual", "deadman", deadman=0.05)
    at_work(backend)
    backend.close()
    time.sleep(0.02)
    with can.Bus(interface="virtual", channel="deadman", ignore_config=True) as ear:
        assert ear.recv(0.2) is None


def test_it_cuts_once_and_again_after_it_was_armed_again() -> None:
    cuts: list[float] = []
    deadman = Deadman(0.02, lambda: cuts.append(time.monotonic()))
    deadman.arm()
    time.sleep(0.2)
    assert len(cuts) == 1
    assert deadman.cut
    deadman.feed()
    time.sleep(0.1)
    assert len(cuts) == 1  # Feeding does not arm.
    deadman.arm()
    time.sleep(0.2)
    assert len(cuts) == 2
    deadman.arm()
    deadman.disarm()
    time.sleep(0.1)
    deadman.close()
    assert len(cuts) == 2


def test_two_hands_on_one_bus_are_driven_from_two_threads() -> None:
    bus = can.Bus(interface="virtual", channel="two hands", ignore_config=True)
    ticks: dict[int, int] = {}

    def drive(device: int, backend: CanBackend) -> None:
        backend.reset()
        for _ in range(80):
            backend.write(TorqueCommand(np.full(16, 0.01)))
            ticks[device] = backend.read().tick

    with Serving(bus, can_config("v4", device=0), can_config("v4", side="left", device=1)) as there:
        pair = [driven("virtual", "two hands", device=0), driven("virtual", "two hands", side="left", device=1)]
        threads = [threading.Thread(target=drive, args=(k, backend)) for k, backend in enumerate(pair)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for backend in pair:
            backend.close()
        assert min(ticks[0], ticks[1]) >= 80
        assert [hand.backend.spec.side for hand in there.firmwares] == ["right", "left"]
