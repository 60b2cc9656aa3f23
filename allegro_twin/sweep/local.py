"""A sweep on this computer: worker processes on its cores, or this process alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

from allegro_twin.errors import ConfigError, HandError
from allegro_twin.sweep.jobs import Result, Sweep, Unit
from allegro_twin.sweep.processors import core_count
from allegro_twin.sweep.units import compute, unit_task
from allegro_twin.sweep.workers import UnitDone, UnitFailed, WorkerLost, Workers

RETRIES = 2
"""Retries of a unit whose process was killed."""
_GIVE_BACK = {"MALLOC_MMAP_THRESHOLD_": "131072"}
"""For glibc, bytes: what is larger goes back to the system when it is freed. Its own way keeps more with every unit:
trials of a 64 took 390 MB a process in the first and 670 MB in the tenth, now 240 and 270."""


class SweepEngine(Protocol):
    """Computes units somewhere."""

    def results(self, sweep: Sweep, units: Sequence[Unit]) -> Iterator[tuple[int, list[Result]]]:
        """The number of each unit with its results, as they come. Raises HandError."""
        ...


class Local:
    """`processes` at once, each a unit at a time; by default one for each core; 0: in this process, one by one."""

    def __init__(self, processes: int | None = None) -> None:
        if processes is not None and processes < 0:
            raise ConfigError(f"processes must be 0 or more, not {processes}")
        self._count = core_count() if processes is None else processes

    def results(self, sweep: Sweep, units: Sequence[Unit]) -> Iterator[tuple[int, list[Result]]]:
        """The number of each unit with its results, as they come. Raises HandError."""
        if self._count and units:
            yield from _apart(sweep, units, min(self._count, len(units)))
        else:
            yield from ((number, compute(unit_task(sweep), unit.items)) for number, unit in enumerate(units))


def _apart(sweep: Sweep, units: Sequence[Unit], count: int) -> Iterator[tuple[int, list[Result]]]:
    left = list(range(len(units)))[::-1]
    died = [0] * len(units)
    with Workers("allegro_twin.sweep.units:compute_in_worker", unit_task(sweep), count, _GIVE_BACK) as workers:
        while left or workers.busy:
            while left and workers.free:
                number = left.pop()
                workers.give(number, units[number].items)
            for event in workers.events():
                match event:
                    case UnitDone(number, results):
                        yield number, results
                    case UnitFailed(_, error):
                        raise error
                    case WorkerLost(number, code):
                        died[number] += 1
                        if code >= 0 or died[number] > RETRIES:
                            raise HandError(_lost(sweep, units[number], code, died[number]))
                        left.append(number)
                    case _:
                        pass  # Units tell nothing.


def _lost(sweep: Sweep, unit: Unit, code: int, times: int) -> str:
    how = f"was killed by signal {-code}, {times} times" if code < 0 else f"ended with code {code}"
    return f"{sweep.function}, {unit}: its process {how}; what is finished stays"
