"""How soon a hand is limp whose program ends, dies or stalls: each way, as a command and as a library, on every link.

The hand is served here, in real time; its driver is another process with the options that a user has by default. The
time is from the death to the moment at which the hand's motors do nothing. `python -m benchmarks.deaths [times]` tries
each way so often.
"""

from __future__ import annotations

import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import can

from allegro_twin.app.config import load_config
from allegro_twin.app.rig import SimulatedScene
from allegro_twin.app.serve_can import virtual_firmware
from allegro_twin.drivers.can.virtual.firmware import Firmware
from allegro_twin.drivers.can.virtual.serve import serve
from allegro_twin.drivers.can.virtual.shared_bus import VirtualHands
from allegro_twin.drivers.can.virtual.slcan import SlcanDevice
from allegro_twin.drivers.can.virtual.socketcand import SocketcandServer
from allegro_twin.errors import LinkError

Figure = tuple[str, float, float, str]
Link = Literal["slcan", "socketcand"]
LINKS: tuple[Link, ...] = ("slcan", "socketcand")
TORQUE = 0.05
"""N·m on every joint: each of them pushes when its program dies."""
SOON, PATIENCE, TRIES = 400.0, 10.0, 5
"""ms within which the hand must be limp; s after which it will never be; how often a program is started for one try."""
SIGNALS = {name: getattr(signal, f"SIG{name}") for name in ("HUP", "QUIT", "TERM", "KILL", "STOP", "INT")}
INSIDE = {
    "abort": "os.abort()",
    "hang": "re.match(r'(x+x+)+y', 'x' * 60)",
    "end": "hand.close(); sys.exit()",
    "exit": "os._exit(0)",
}
"""What a library program does to itself; `hang` is native code that holds the interpreter."""
LIBRARY = f"""
import os, re, sys, time
from allegro_twin.surfaces.hand import Hand
hand = Hand.open(sys.argv[1])
hand.set_controller("torque", torque={TORQUE})
hand.wait(0.3)
print("driving", flush=True)
how = sys.stdin.readline().strip()
print(time.monotonic(), flush=True)
exec(how)
time.sleep(60)
"""


def config(folder: Path, link: Link, port: int) -> Path:
    """A hand that is driven with a torque on every joint, as a user would write it."""
    ways = {
        "slcan": f"interface: slcan, channel: {folder / 'hand.tty'}, options: {{sleep_after_open: 0.0}}",
        "socketcand": f"interface: socketcand, channel: can0, options: {{host: 127.0.0.1, port: {port}}}",
    }
    path = folder / "hand.yaml"
    path.write_text(
        f"backend: {{kind: can, version: v4, {ways[link]}, gravity: [0, 0, -9.81], timeout: 0.5}}\n"
        f"controller: {{kind: torque, torque: {TORQUE}}}\n"
    )
    return path


@dataclass
class Served:
    """A hand in real time, on a thread, and since when it does nothing."""

    firmware: Firmware
    hands: VirtualHands
    bus: can.BusABC
    path: Path

    def __post_init__(self) -> None:
        self._over, self.limp_since = threading.Event(), time.monotonic()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def pushes(self) -> bool:
        """Whether any motor does anything."""
        return self.firmware.serving and any(self.firmware.torque)

    def close(self) -> None:
        self._over.set()
        self._thread.join(10.0)
        self.bus.shutdown()

    def _serve(self) -> None:
        for _ in serve(self.hands, self.bus):
            if self.pushes:
                self.limp_since = 0.0
            elif not self.limp_since:
                self.limp_since = time.monotonic()
            if self._over.is_set():
                return


@contextmanager
def served(link: Link) -> Iterator[Served]:
    """A hand on one of the links."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bus: can.BusABC
        if link == "slcan":
            bus, port = SlcanDevice(folder / "hand.tty"), 0
        else:
            bus = server = SocketcandServer("can0", port=0)
            port = server.address[1]
        path = config(folder, link, port)
        firmware = virtual_firmware(load_config(path), SimulatedScene(), step=0.003, restart=True)
        hand = Served(firmware, VirtualHands([firmware]), bus, path)
        try:
            yield hand
        finally:
            hand.close()


def died(hand: Served, way: str, *, library: bool) -> float:
    """Seconds from a program's death to its limp hand; infinite for one that goes on pushing. A program that its own
    deadman has ended before, on a busy computer, is started again."""
    for _ in range(TRIES):
        if (seconds := _tried(hand, way, library=library)) is not None:
            return seconds
    raise LinkError(f"the hand was cut off {TRIES} times before its program died; is this computer too busy?")


def _tried(hand: Served, way: str, *, library: bool) -> float | None:
    ends = ["--seconds", "0.6"] if way == "end" else []
    command = ["-c", LIBRARY, str(hand.path)] if library else ["-m", "allegro_twin", "run", str(hand.path), *ends]
    program = subprocess.Popen(
        [sys.executable, *command],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    try:
        _await(lambda: hand.pushes, 30.0)
        _pause(0.1)
        if not hand.pushes:
            return None
        began = _kill(program, way, library=library)
        _await(lambda: hand.limp_since > 0.0, PATIENCE)
        limp = hand.limp_since
        if way == "STOP":
            _pause(max(began + 3.0 - time.monotonic(), 0.0))
            program.send_signal(signal.SIGCONT)
        _pause(0.4)  # A torque that comes late would be seen.
        return max(limp - began, 0.0) if limp and hand.limp_since == limp else float("inf")
    finally:
        program.kill()
        program.communicate()
        _await(lambda: hand.limp_since > 0.0, PATIENCE)


def _kill(program: subprocess.Popen[str], way: str, *, library: bool) -> float:
    """When it died."""
    if way == "end" and not library:
        assert program.wait(30.0) == 0
        return time.monotonic()
    if way in SIGNALS:
        began = time.monotonic()
        program.send_signal(SIGNALS[way])
        return began
    assert program.stdin is not None
    assert program.stdout is not None
    program.stdout.readline()
    program.stdin.write(INSIDE[way] + "\n")
    program.stdin.flush()
    return float(program.stdout.readline())


def _await(condition: object, seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:  # type: ignore[operator]  # A function of nothing.
        _pause(0.002)


def _pause(seconds: float) -> None:
    time.sleep(seconds)


def ways() -> Iterator[tuple[str, bool]]:
    """Every way to die, and whether as a library."""
    for way in ("HUP", "QUIT", "TERM", "KILL", "STOP"):
        yield way, False
        yield way, True
    for way in INSIDE:
        yield way, True
    yield "end", False


def figures(times: int = 1) -> Iterator[Figure]:
    for link in LINKS:
        with served(link) as hand:
            for way, library in ways():
                seconds = [died(hand, way, library=library) for _ in range(times)]
                who = "library" if library else "command"
                limp = sum(1000.0 * each <= SOON for each in seconds)
                middle = 1000.0 * statistics.median(seconds)
                what = f"limp after {way}, {who}, {link}: {limp} of {times}, median {middle:.0f}"
                yield what, 1000.0 * max(seconds), SOON, "ms"


if __name__ == "__main__":
    for what, measured, bar, unit in figures(int(sys.argv[1]) if len(sys.argv) > 1 else 20):
        print(f"{what:<70}{measured:>10.0f} {unit:<2}{bar:>8} {unit}", flush=True)
