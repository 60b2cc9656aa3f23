"""A hand and its driver as two processes on interfaces of the kernel; both are forks, for imports take long there."""

from __future__ import annotations

import os
import select
import signal
import socket
import struct
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import can
import numpy as np

# What commands import when they need it: here once, before any fork.
import allegro_twin.app.bus_listener
import allegro_twin.app.session
import allegro_twin.control.controllers
import allegro_twin.drivers.can.opening
import allegro_twin.recording.recorder
import allegro_twin.surfaces.cli.console
import allegro_twin.surfaces.cli.hardware.bus_tables
import allegro_twin.surfaces.cli.start.jobs  # noqa: F401
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.virtual.firmware import Firmware
from allegro_twin.drivers.can.virtual.serve import serve
from allegro_twin.drivers.can.virtual.shared_bus import VirtualHands
from allegro_twin.drivers.can.virtual.slcan import SlcanDevice
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.recording.reader import load
from allegro_twin.spec import HandSpec, Side
from allegro_twin.surfaces.cli.main import main
from allegro_twin.types import Command, HandState, Vector, frozen
from tests.patience import comes_true

PERIOD = 0.02
"""s: a system call takes a tenth of a millisecond there, and one processor serves everybody."""
TORQUE = 0.05
"""N·m on every joint."""
SIDES: tuple[Side, Side] = ("right", "left")
BEGIN = (0.1, 0.3)
"""rad: what tells the hand of device 0 from that of device 1."""
_RCVBUFFORCE = 33  # asm-generic/socket.h
_SHARED = struct.Struct("<dd?xxxxxxxQ")


class Seen(NamedTuple):
    """What the hand's process says of itself."""

    limp_since: float
    """s on the monotonic clock; 0 while any motor pushes."""
    heard_at: float
    """When it last heard anything."""
    serving: bool
    heard: int


class DriftingHand:
    """A hand without physics: joints drift about where they began, and never rest."""

    def __init__(self, spec: HandSpec, period: float = PERIOD, begin: float = 0.1) -> None:
        self.spec, self.period = spec, period
        self._tick, self._torque = 0, np.zeros(16)
        self._position = np.clip(np.zeros(16), spec.lower, spec.upper) + begin

    def reset(self) -> HandState:
        self._tick = 0
        return self._state()

    def write(self, command: Command) -> None:
        self._torque = command.torque  # type: ignore[union-attr]  # It takes torques.

    def read(self) -> HandState:
        self._tick += 1
        self._position += 1e-3 * np.sin(0.1 * self._tick + np.arange(16.0))
        return self._state()

    def close(self) -> None:
        pass

    def _state(self) -> HandState:
        zero: Vector = frozen(np.zeros(16))
        position = frozen(self._position)
        return HandState(
            self._tick * self.period, self._tick, position, zero, frozen(self._torque), zero, frozen([0, 0, -9.8])
        )


@contextmanager
def forked(work: Callable[[], object]) -> Iterator[int]:
    """A process that does this, killed in the end."""
    sys.stdout.flush()
    process = os.fork()
    if process == 0:
        status = 70
        try:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            work()
            status = 0
        except SystemExit as error:
            status = int(error.code or 0)
        except BaseException:  # noqa: BLE001  # It must not go on as a second pytest.
            traceback.print_exc()
        finally:
            os._exit(status)
    try:
        yield process
    finally:
        comes_true(lambda: ended(process), 0.0)
        if not ended(process):
            os.kill(process, signal.SIGKILL)
            os.kill(process, signal.SIGCONT)
            os.waitpid(process, 0)


_STATUS: dict[int, int] = {}


def ended(process: int) -> bool:
    """Whether a process is over; its exit status is kept."""
    if process not in _STATUS:
        found, status = os.waitpid(process, os.WNOHANG)
        if found:
            _STATUS[process] = os.waitstatus_to_exitcode(status)
    return process in _STATUS


def exit_code(process: int, seconds: float = 60.0) -> int:
    """Wait for its end."""
    assert comes_true(lambda: ended(process), seconds)
    return _STATUS[process]


class Served:
    """A hand in a process of its own; what it says of itself is in shared memory."""

    def __init__(self, channel: str, device: int, period: float) -> None:
        import mmap

        self._memory = mmap.mmap(-1, _SHARED.size)
        self._channel, self._device, self._period = channel, device, period

    def __call__(self) -> None:
        serial = "/" in self._channel
        bus = SlcanDevice(Path(self._channel)) if serial else can.Bus(self._channel, "socketcan", ignore_config=True)
        spec, begin = load_spec(side=SIDES[self._device]), BEGIN[self._device]
        hand = Firmware(DriftingHand(spec, self._period, begin), make_codec("v4", device=self._device))
        limp_since, heard, heard_at = time.monotonic(), 0, 0.0
        for served in serve(VirtualHands([hand]), bus, local=not serial):
            pushes = hand.serving and any(hand.torque)
            limp_since = 0.0 if pushes else limp_since or time.monotonic()
            if served.heard != heard:
                heard, heard_at = served.heard, time.monotonic()
            self._memory[:] = _SHARED.pack(limp_since, heard_at, hand.serving, heard)

    @property
    def seen(self) -> Seen:
        return Seen(*_SHARED.unpack(self._memory[:]))

    @property
    def pushes(self) -> bool:
        return self.seen.heard > 0 and not self.seen.limp_since


@contextmanager
def hand_on(channel: str, device: int = 0, period: float = PERIOD) -> Iterator[Served]:
    """A hand on an interface, or behind a serial adapter at a path; device 1 is a left one."""
    served = Served(channel, device, period)
    with forked(served):
        assert comes_true(lambda: served.seen.limp_since > 0.0, 30.0)
        yield served


def config(folder: Path, channel: str, device: int = 0, period: float = PERIOD, **backend: object) -> Path:
    """A hand on an interface, with a torque on every joint and the options that a user has by default, but slower."""
    path = folder / f"hand{device}.yaml"
    more = "".join(f", {key}: {value}" for key, value in backend.items())
    path.write_text(
        f"hand: {{model: allegro, side: {SIDES[device]}}}\n"
        f"backend: {{kind: can, version: v4, interface: socketcan, channel: {channel}, device: {device}, "
        f"gravity: [0, 0, -9.81], timeout: 1.0{more}}}\n"
        f"controller: {{kind: torque, torque: {TORQUE}}}\nperiod: {period}\n"
    )
    return path


def command(*words: object) -> Callable[[], None]:
    """`allegro-twin …`"""

    def work() -> None:
        sys.argv = ["allegro-twin", *map(str, words)]
        main()

    return work


def assert_recorded(recording: Path, device: int = 0) -> None:
    """States of this hand are in it. Which share of the periods is asked where time is steady: socketcan/timed."""
    positions = load(recording).columns["position"]
    assert len(positions)
    np.testing.assert_allclose(positions[:, 0], BEGIN[device], atol=0.05)


def ip(*words: str) -> None:
    """Of iproute2."""
    subprocess.run(["ip", *words], check=True)


@contextmanager
def delayed(channel: str, *words: str) -> Iterator[None]:
    """A queueing discipline in the way of what is sent on an interface."""
    subprocess.run(["tc", "qdisc", "add", "dev", channel, "root", "netem", *words], check=True)
    try:
        yield
    finally:
        subprocess.run(["tc", "qdisc", "del", "dev", channel, "root"], check=True)


@contextmanager
def ear(channel: str) -> Iterator[socket.socket]:
    """A raw socket that hears everything on an interface."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as raw:
        raw.setsockopt(socket.SOL_SOCKET, _RCVBUFFORCE, 1 << 23)  # It is read at the end.
        raw.bind((channel,))
        raw.setblocking(False)
        yield raw


def said_until_quiet(raw: socket.socket, seconds: float = 2.0) -> list[tuple[int, bytes]]:
    """What it has heard until nobody said a word for so long (a keeper repeats after 0.1 s)."""
    heard: list[tuple[int, bytes]] = []
    while select.select([raw], [], [], seconds)[0]:
        identifier, length, data = struct.unpack("=IB3x8s", raw.recv(16))
        heard.append((identifier & 0x7FF, data[:length]))
    return heard
