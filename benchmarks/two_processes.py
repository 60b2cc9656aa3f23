"""A hand and its driver in two processes, in real time, over slcan: `python -m benchmarks.two_processes [seconds]`.

`allegro-twin firmware` is the hand, in the cube's scene; the driver performs the grasp and then keeps it, as slowly as
the hand reports. Neither asks for real-time scheduling, as nobody does who types what the README says.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from allegro_twin.app import assemble
from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.link.buses import shared
from allegro_twin.drivers.can.virtual.firmware import Firmware
from allegro_twin.drivers.can.virtual.serve import serve
from allegro_twin.drivers.can.virtual.shared_bus import VirtualHands
from allegro_twin.drivers.can.virtual.slcan import SlcanDevice
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.loop import run, until
from allegro_twin.types import Array, TorqueCommand
from benchmarks.fuzz import CountingHand, told

Figure = tuple[str, float, float, str]
SCENARIO, PERIOD = "rubiks_cube", 0.003


class Found(NamedTuple):
    """What a link did in a while."""

    intervals: Array
    """Between two states, as the host's clock saw them, s."""
    used: float
    """Share of the hand's periods of which there was a state."""
    doubtful: int
    """Periods not used because their reports may have been of two."""
    share: float
    """Of one core that the driver took."""
    held: bool
    """The verdict that the hand's own process gave."""
    hand: str
    """What the hand's process said at its end."""


def measure(seconds: float, *, realtime: bool) -> Found:
    """Perform the grasp, and go on holding until so many seconds are over. Raises HandError."""
    with tempfile.TemporaryDirectory() as folder:
        path = _config(Path(folder), seconds, realtime=realtime)
        with _hand(path) as program:
            found = _driven(load_config(path), realtime=realtime)
            program.send_signal(signal.SIGINT)
            said, _ = program.communicate(timeout=30)
    last = said.strip().splitlines()[-1]
    return found._replace(held=re.search(r"right\b.*: held", said) is not None, hand=last)


def torn(seconds: float) -> tuple[int, int]:
    """States, and how many of them mix two periods, from a hand in another process whose joints count its periods."""
    with tempfile.TemporaryDirectory() as folder:
        tty = Path(folder) / "hand.tty"
        with _waited([sys.executable, "-m", "benchmarks.two_processes", "counting", str(tty)], tty):
            options = {"sleep_after_open": 0.0}
            port = shared("slcan", str(tty), 1_000_000, options).port()
            settings = CanHostSettings(identify=False, gravity=(0.0, 0.0, -9.81), timeout=2.0, deadman=None)
            with closing(CanBackend(load_spec(), make_codec("v4"), lambda: port, settings)) as backend:
                state, states, mixed = backend.reset(), 0, 0
                while state.t < seconds:
                    backend.write(TorqueCommand(np.zeros(16)))
                    state = backend.read()
                    states, mixed = states + 1, mixed + (len(set(told(state))) > 1)
    return states, mixed


def count_on(tty: Path) -> None:
    """Be the hand whose joints count its periods."""
    hands = VirtualHands([Firmware(CountingHand(load_spec()), make_codec("v4"))])
    for _ in serve(hands, SlcanDevice(tty)):
        pass


def _config(folder: Path, seconds: float, *, realtime: bool) -> Path:
    path = folder / "hand.yaml"
    path.write_text(
        f"backend: {{kind: can, version: v4, interface: slcan, channel: {folder / 'hand.tty'}, imu: 0.1,\n"
        f"  options: {{sleep_after_open: 0.0}}, realtime: {str(realtime).lower()}, timeout: 0.5}}\n"
        f"task: {{scenario: {SCENARIO}}}\ncontroller: {{kind: pd}}\nseconds: {seconds}\n"
    )
    return path


def _hand(config: Path) -> AbstractContextManager[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "allegro_twin", "firmware", str(config)]
    return _waited(command, config.parent / "hand.tty")


@contextmanager
def _waited(command: list[str], tty: Path) -> Iterator[subprocess.Popen[str]]:
    """A program, once its terminal is there; killed at the end if it did not end."""
    program = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        deadline = time.monotonic() + 60.0
        while not tty.exists() and time.monotonic() < deadline:
            if program.poll() is not None:
                raise RuntimeError(program.communicate()[0])
            time.sleep(0.05)
        yield program
    finally:
        if program.poll() is None:
            program.kill()
        program.communicate()


def _driven(config: RunConfig, *, realtime: bool) -> Found:
    rig = assemble(config)
    assert isinstance(rig.driver, CanBackend)
    assert rig.seconds is not None
    stamps, ticks = [], []
    with closing(rig.backend):
        cpu, begin = time.thread_time(), time.perf_counter()
        for sample in until(rig.seconds, run(rig.backend, rig.controller)):
            stamps.append(time.perf_counter())
            ticks.append(sample.state.tick)
        share = (time.thread_time() - cpu) / (time.perf_counter() - begin)
        health = rig.driver.health
    return Found(np.diff(stamps), (len(ticks) - 1) / ticks[-1], health.doubtful, share, held=False, hand="")


def figures(seconds: float = 60.0) -> Iterator[Figure]:
    """Ratios and times of a minute; the bars are for an otherwise idle computer."""
    found = measure(seconds, realtime=False)
    where = f"two processes, slcan, {seconds:.0f} s"
    ms = 1000.0 * np.quantile(found.intervals, [0.5, 0.99, 1.0])
    yield f"{where}: periods used (at least)", 100.0 * found.used, 98.0, "%"
    yield f"{where}: p50 tick interval", float(ms[0]), 3.0, "ms"
    yield f"{where}: p99 tick interval", float(ms[1]), 6.0, "ms"
    yield f"{where}: worst tick interval", float(ms[2]), 50.0, "ms"
    yield f"{where}: driver's share of a core", 100.0 * found.share, 30.0, "%"
    yield f"{where}: periods not used, as of two", float(found.doubtful), 0.01 * seconds / PERIOD, ""
    states, mixed = torn(seconds / 4)
    yield f"two processes: torn states among {states}", float(mixed), 0.0, ""
    yield f"{where}: held (1: yes)", float(found.held), 1.0, ""


def main() -> None:
    if sys.argv[1:2] == ["counting"]:
        count_on(Path(sys.argv[2]))
    for what, measured, bar, unit in figures(float(sys.argv[1]) if len(sys.argv) > 1 else 60.0):
        print(f"{what:<78}{measured:>9.2f} {unit:<2}{bar:>8} {unit}")


if __name__ == "__main__":
    main()
