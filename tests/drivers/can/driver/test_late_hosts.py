"""A host that is slower than its bus gets states, and programs on one serial line do not take each other's bytes."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import can
import numpy as np
import pytest

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.link.adapter import AdapterLink
from allegro_twin.drivers.can.link.buses import open_bus
from allegro_twin.drivers.can.link.shared_bus import Stamped
from allegro_twin.drivers.can.virtual.slcan import TAP, SlcanDevice
from allegro_twin.errors import LinkError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.types import TorqueCommand
from benchmarks.deaths import served
from tests.patience import wait_for

V4 = make_codec("v4")
OPTIONS = {"sleep_after_open": 0.0}


class Endless(can.BusABC):
    """A bus on which more always waits: a frame takes a millisecond to read, and four come in three."""

    def __init__(self) -> None:
        self._finger = 0
        self.channel_info = "endless"
        super().__init__("endless")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        pass

    def recv(self, timeout: float | None = None) -> can.Message | None:
        select.select([], [], [], 0.001)
        frame = V4.encode(m.FingerPosition(self._finger, (0.1, 0.2, 0.3, 0.4)))
        self._finger = (self._finger + 1) % 4
        return can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False, timestamp=time.time())


@pytest.mark.realtime
def test_a_read_ends_though_more_waits_and_the_hand_is_not_cut_off() -> None:
    settings = CanHostSettings(identify=False, gravity=(0.0, 0.0, -9.81), deadman=0.1)
    backend = CanBackend(load_spec(), V4, AdapterLink(Endless()).port, settings)
    backend.reset()
    for _ in range(20):
        began = time.monotonic()
        backend.write(TorqueCommand(np.zeros(16)))
        backend.read()
        assert time.monotonic() - began < 0.08
    assert backend.health.behind > 0
    assert any("this computer is slower than the bus" in line for line in backend.warnings())
    backend.close()


@pytest.fixture
def device(tmp_path: Path) -> SlcanDevice:
    return SlcanDevice(tmp_path / "hand.tty")


def test_all_that_waits_on_a_serial_line_is_read_at_once(
    device: SlcanDevice, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus = open_bus("slcan", str(tmp_path / "hand.tty"), 1_000_000, OPTIONS)
    while device.recv(0.01) is not None:
        pass
    assert bus.recv(0.01) is None
    for k in range(100):
        device.send(can.Message(arbitration_id=0x80 + k, data=bytes(8), is_extended_id=False))
    calls, read = 0, os.read

    def counted(descriptor: int, length: int) -> bytes:
        nonlocal calls
        calls += 1
        return read(descriptor, length)

    monkeypatch.setattr(os, "read", counted)
    assert [message.arbitration_id for message in iter(lambda: bus.recv(0.0), None)] == [0x80 + k for k in range(100)]
    assert calls <= 3
    monkeypatch.undo()
    bus.shutdown()
    device.shutdown()


def test_a_line_that_is_cut_says_that_something_was_lost_and_ends_nothing(device: SlcanDevice, tmp_path: Path) -> None:
    bus = open_bus("slcan", str(tmp_path / "hand.tty"), 1_000_000, OPTIONS)
    (adapter, _) = device._adapters.values()
    for line in (b"t0808001122\r", b"t08\r", b"t0808zz11223344556677\r", b"t0801AA\r"):
        os.write(adapter.master, line)
    messages = [bus.recv(0.1) for _ in range(4)]
    assert [message is not None and message.is_error_frame for message in messages] == [True, True, True, False]
    link = AdapterLink(bus)
    port = link.port()
    os.write(adapter.master, b"t0808001122\r")
    assert link.pump(0.1)
    came = port.queue.popleft()
    assert isinstance(came, Stamped)
    assert came.frame.id == -1
    link.leave(port)
    device.shutdown()


def test_a_full_terminal_says_that_something_may_be_lost(device: SlcanDevice, tmp_path: Path) -> None:
    bus = open_bus("slcan", str(tmp_path / "hand.tty"), 1_000_000, OPTIONS)
    while device.recv(0.01) is not None:
        pass
    for _ in range(2000):
        device.send(can.Message(arbitration_id=0x80, data=bytes(8), is_extended_id=False))
    kinds = [message.is_error_frame for message in iter(lambda: bus.recv(0.05), None)]
    assert kinds.count(False) < 2000
    assert kinds[-1]  # After the last frame that was kept.
    bus.shutdown()
    device.shutdown()


@pytest.mark.realtime
def test_a_serial_port_has_one_driver_and_who_has_it_is_said(tmp_path: Path) -> None:
    with served("slcan") as hand:
        command = [sys.executable, "-m", "allegro_twin", "run", str(hand.path)]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as first:
            wait_for(lambda: hand.pushes, "a torque")
            second = subprocess.run(command, capture_output=True, text=True)
            assert second.returncode == 3
            assert f"`allegro_twin run {hand.path}` (pid {first.pid})" in second.stderr
            assert "serves one program at a time" in second.stderr
            assert hand.pushes  # The first one noticed nothing.
            assert first.poll() is None
            first.terminate()
            assert first.wait() == 128 + signal.SIGTERM


@pytest.mark.realtime
def test_a_tap_hears_the_hand_and_its_driver_and_disturbs_nobody(tmp_path: Path) -> None:
    with served("slcan") as hand:
        command = [sys.executable, "-m", "allegro_twin"]
        with subprocess.Popen([*command, "run", str(hand.path)], stdout=subprocess.DEVNULL) as driver:
            wait_for(lambda: hand.pushes, "a torque")
            heard = subprocess.run(
                [*command, "sniff", str(hand.path), "--seconds", "0.5", "--lines"], capture_output=True, text=True
            )
            assert heard.returncode == 0, heard.stderr
            assert "torque index" in heard.stdout
            assert "position thumb" in heard.stdout
            assert hand.pushes
            driver.terminate()
            assert driver.wait() == 128 + signal.SIGTERM


def test_a_real_adapter_has_no_tap_so_listening_beside_its_driver_is_refused(
    device: SlcanDevice, tmp_path: Path
) -> None:
    driver = open_bus("slcan", str(tmp_path / "hand.tty"), 1_000_000, OPTIONS)
    (tmp_path / f"hand.tty{TAP}").unlink()
    with pytest.raises(
        LinkError, match=rf"\(pid {os.getpid()}\) has this port, which serves one program at a time: wait"
    ):
        open_bus("slcan", str(tmp_path / "hand.tty"), 1_000_000, {"listen_only": True, **OPTIONS})
    driver.shutdown()
    device.shutdown()
