"""What of a core hands and their keepers take in real time, and how soon a hand is cut off where there is no keeper.

The hands are a program of their own; the time is from the program's last call to the servo-off frame. With keepers:
benchmarks/deaths.py. `python -m benchmarks.deadman load [SECONDS]`: how often a busy computer cuts a
healthy program off.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import can
import numpy as np

from allegro_twin.drivers.can.codec.v4 import SERVO_OFF
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.link.adapter import AdapterLink
from allegro_twin.drivers.can.link.buses import open_bus
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.types import TorqueCommand

Figure = tuple[str, float, float, str]
PATIENCE, ROUNDS, SECONDS = 0.1, 10, 5.0


def figures() -> Iterator[Figure]:
    for what, hang in (("sleeps", _sleep), ("spins in Python", _spin)):
        times = [1000.0 * seconds for seconds in _cut_off(hang)]
        yield f"cut-off without a keeper, the program {what}: median of {ROUNDS}", statistics.median(times), 120.0, "ms"
        yield f"cut-off without a keeper, the program {what}: worst of {ROUNDS}", max(times), 200.0, "ms"
    for hands in (1, 2):
        driver, keeper = _shares(hands)
        yield f"share of a core, hands driven: {hands}, torque alone", 100.0 * driver, 30.0 * hands, "%"
        yield "  each keeper", 100.0 * keeper, 2.0, "%"


def gaps(busy: int, seconds: float) -> tuple[list[float], float]:
    """s between two calls of a program that drives a hand beside so many busy loops; the share of its time for which it
    was ready to run and had no core."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        driven = _Driven(Path(folder), deadman=None, keeper=True)
        stack.callback(driven.close)
        driven.backend.reset()
        for _ in range(busy):
            loop = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            stack.callback(loop.wait)
            stack.callback(loop.kill)
        found, waited, begin = list[float](), _waited(), time.monotonic()
        last, feed = [begin], driven.backend._watch.feed

        def fed() -> None:
            feed()
            now = time.monotonic()
            found.append(now - last[0])
            last[0] = now

        driven.backend._watch.feed = fed  # type: ignore[method-assign]
        while time.monotonic() < begin + seconds:
            driven.step()
        return found, (_waited() - waited) / (time.monotonic() - begin)


def table(seconds: float = 60.0) -> Iterator[str]:
    """How often a deadman would have cut off a healthy program, by load."""
    patiences = (0.05, 0.1, 0.2, 0.3, 0.5)
    yield "| busy loops | load | waits for a core | longest gap | " + " | ".join(f"{p:g} s" for p in patiences) + " |"
    yield "|---|---|---|---|" + "---|" * len(patiences)
    for busy in (0, 4, 12, 24):
        found, waits = gaps(busy, seconds)
        cuts = " | ".join(str(sum(gap > patience for gap in found)) for patience in patiences)
        yield f"| {busy} | {os.getloadavg()[0]:.0f} | {waits:.0%} | {1000 * max(found):.0f} ms | {cuts} |"


def _waited() -> float:
    """s for which this process was ready to run and had no core."""
    return 1e-9 * float(Path("/proc/self/schedstat").read_text().split()[1])


def _sleep() -> None:
    time.sleep(4 * PATIENCE)


def _spin() -> None:
    end = time.monotonic() + 4 * PATIENCE
    while time.monotonic() < end:
        sum(range(1000))


class _Driven:
    """A hand in another process, driven over slcan."""

    def __init__(self, folder: Path, *, deadman: float | None, keeper: bool) -> None:
        self._tty = folder / "hand.tty"
        command = [sys.executable, "-m", "benchmarks.two_processes", "counting", str(self._tty)]
        self._program = subprocess.Popen(command)
        while not self._tty.exists() and self._program.poll() is None:
            time.sleep(0.05)
        self.off: list[float] = []
        settings = CanHostSettings(
            identify=False, gravity=(0.0, 0.0, -9.81), timeout=2.0, deadman=deadman, keeper=keeper
        )
        options = {"sleep_after_open": 0.0}
        bus = open_bus("slcan", str(self._tty), 1_000_000, options)
        self._link = AdapterLink(bus, address=bus.address)  # type: ignore[attr-defined]  # Ours has one.
        self._link.listen(self._listen)
        self.backend = CanBackend(load_spec(), make_codec("v4"), self._link.port, settings)

    def _listen(self, message: can.Message) -> None:
        if message.arbitration_id >> 2 == SERVO_OFF:
            self.off.append(time.monotonic())

    def step(self) -> None:
        self.backend.write(TorqueCommand(np.full(16, 0.05)))
        self.backend.read()

    def close(self) -> None:
        self.backend.close()
        self._program.kill()
        self._program.wait()


def _cut_off(hang: Callable[[], None]) -> list[float]:
    times = []
    with tempfile.TemporaryDirectory() as folder:
        driven = _Driven(Path(folder), deadman=PATIENCE, keeper=False)
        for _ in range(ROUNDS):
            driven.backend.reset()
            for _ in range(20):
                driven.step()
            begin = time.monotonic()
            driven.off.clear()
            hang()
            times.append(driven.off[0] - begin)
        driven.close()
    return times


def _shares(hands: int) -> tuple[float, float]:
    """Of one core: what drives the hands, and each of their keepers."""
    with ExitStack() as stack:
        folders = [Path(stack.enter_context(tempfile.TemporaryDirectory())) for _ in range(hands)]
        patience = PATIENCE if hands == 1 else 1.0  # The first waits while the second says hello.
        driven = [_Driven(folder, deadman=patience, keeper=True) for folder in folders]
        for one in driven:
            stack.callback(one.close)
            one.backend.reset()
        keepers = [one.backend.keeper for one in driven]
        cpu, kept, begin = time.process_time(), sum(map(_spent, keepers)), time.perf_counter()
        while (elapsed := time.perf_counter() - begin) < SECONDS:
            for one in driven:
                one.step()
        return (time.process_time() - cpu) / elapsed, (sum(map(_spent, keepers)) - kept) / elapsed / hands


def _spent(process: int) -> float:
    """CPU time of a process, s."""
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    if sys.argv[1:2] == ["load"]:
        for line in table(*map(float, sys.argv[2:3])):
            print(line, flush=True)
        sys.exit()
    for what, measured, bar, unit in figures():
        print(f"{what:<58}{measured:>10.2f} {unit:<2}{bar:>8} {unit}")
