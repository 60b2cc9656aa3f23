"""What a period costs through the vendor's SDK and sixteen virtual servos, as a multiple of the simulation alone."""

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
from allegro_twin.types import PositionCommand

PERIODS, ROUNDS = 100, 31
Figure = tuple[str, float, float, str]
LINE = {"kind": "dynamixel", "port": "virtual", "baud": 4_000_000}
ALONE = {"posture": "leap_home"}
GRASP = {"scenario": "leap_rubiks_cube"}


def figures() -> Iterator[Figure]:
    for period in (0.02, 0.01):
        for what, task in (("alone", ALONE), ("in the loop, at a grasp", GRASP)):
            timer = _bare if task is ALONE else _loop
            found, sim, line = ratio(timer(task, period, line=False), timer(task, period, line=True))
            yield f"{1000 * period:.0f} ms through sixteen servos, {what} ({sim:.0f} → {line:.0f} µs)", found, 2.5, "x"


def config(task: dict[str, Any], period: float, *, line: bool) -> RunConfig:
    return RunConfig.model_validate(
        {
            "hand": {"model": "leap"},
            "backend": LINE if line else {"kind": "sim"},
            "task": task,
            "controller": {"kind": "position"},
            "period": period,
        }
    )


def _bare(task: dict[str, Any], period: float, *, line: bool) -> Callable[[], float]:
    """Write and read, without controller and guard, a little further each time."""
    rig = assemble(config(task, period, line=line))
    inner = rig.driver
    spec = rig.spec
    middle, width = (spec.lower + spec.upper) / 2, 0.05 * (spec.upper - spec.lower)
    inner.reset()

    def timed() -> float:
        begin = time.perf_counter()
        for k in range(PERIODS):
            inner.write(PositionCommand(middle + width * np.sin(0.05 * k + np.arange(16.0))))
            inner.read()
        return (time.perf_counter() - begin) / PERIODS

    return timed


def _loop(task: dict[str, Any], period: float, *, line: bool) -> Callable[[], float]:
    """Controller and guard, from the same moment of the motion each time."""
    rig = assemble(config(task, period, line=line))

    def timed() -> float:
        samples = run(rig.backend, rig.controller)
        next(samples)
        begin = time.perf_counter()
        for _ in islice(samples, PERIODS):
            pass
        elapsed = (time.perf_counter() - begin) / PERIODS
        samples.close()  # type: ignore[attr-defined]  # A generator, though typed as an iterator.
        return elapsed

    return timed


def ratio(bare: Callable[[], float], other: Callable[[], float]) -> tuple[float, float, float]:
    """Median of ratios that were taken in turn, for others use the machine too; and both medians, µs."""
    bare(), other()
    rows = [(bare(), other()) for _ in range(ROUNDS)]
    sim, line = (1e6 * statistics.median(column) for column in zip(*rows, strict=True))
    return statistics.median(there / here for here, there in rows), sim, line


if __name__ == "__main__":
    for what, measured, bar, unit in figures():
        print(f"{what:<84}{measured:>8.2f} {unit:<2}{bar:>6} {unit}")
