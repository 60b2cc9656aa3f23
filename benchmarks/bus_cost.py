"""What a control period costs through codec, firmware and virtual bus, as a multiple of the simulation alone."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

import numpy as np

from allegro_twin.app import assemble
from allegro_twin.app.config import RunConfig
from allegro_twin.loop import run
from allegro_twin.types import TorqueCommand

PERIODS, ROUNDS = 1000, 9
Figure = tuple[str, float, float, str]
ALONE: dict[str, Any] = {"task": {"posture": "home"}, "controller": {"kind": "pid"}}
GRASP: dict[str, Any] = {"task": {"scenario": "rubiks_cube"}, "controller": {"kind": "pd"}}
WIRE = {"kind": "can", "version": "v4", "interface": "allegro-virtual", "imu": 0.1}


def config(task: dict[str, Any], *, bus: bool) -> RunConfig:
    return RunConfig.model_validate({"backend": WIRE if bus else {"kind": "sim"}, **task})


def figures() -> Iterator[Figure]:
    yield "period through the virtual bus, backend alone", _ratio(_bare(bus=False), _bare(bus=True)), 2.0, "x"
    yield (
        "period through the virtual bus, PID + guard",
        _ratio(_loop(ALONE, bus=False), _loop(ALONE, bus=True)),
        2.0,
        "x",
    )
    yield (
        "period through the virtual bus, at a grasp",
        _ratio(_loop(GRASP, bus=False), _loop(GRASP, bus=True)),
        2.0,
        "x",
    )


def _bare(*, bus: bool) -> Callable[[], float]:
    """Write and read, without controller and guard."""
    rig = assemble(config(ALONE, bus=bus))
    inner = rig.driver
    inner.reset()
    limp = TorqueCommand(np.zeros(16))

    def timed() -> float:
        begin = time.perf_counter()
        for _ in range(PERIODS):
            inner.write(limp)
            inner.read()
        return time.perf_counter() - begin

    return timed


def _loop(task: dict[str, Any], *, bus: bool) -> Callable[[], float]:
    """The whole loop, from the same moment of the motion each time."""
    rig = assemble(config(task, bus=bus))

    def timed() -> float:
        samples = run(rig.backend, rig.controller)
        next(samples)
        begin = time.perf_counter()
        for _ in islice(samples, PERIODS):
            pass
        elapsed = time.perf_counter() - begin
        samples.close()  # type: ignore[attr-defined]  # A generator, though typed as an iterator.
        return elapsed

    return timed


def _ratio(bare: Callable[[], float], other: Callable[[], float]) -> float:
    """Median of ratios that were taken in turn, for others use the machine too."""
    bare(), other()
    return statistics.median(other() / bare() for _ in range(ROUNDS))


if __name__ == "__main__":
    for what, measured, bar, unit in figures():
        print(f"{what:<58}{measured:>10.2f} {unit:<2}{bar:>8} {unit}")
