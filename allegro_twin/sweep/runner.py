"""Runs a sweep: computes the rows that are missing, stores them as they come, and returns all in order."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing, nullcontext
from typing import Any

from allegro_twin.sweep.jobs import Sweep
from allegro_twin.sweep.local import Local, SweepEngine
from allegro_twin.sweep.store import MemoryStore, Store
from allegro_twin.sweep.table import ordered_table, unit_table

Progress = Callable[[int, int], None]
"""Called with the number of items that are done, and of all."""


def run(
    sweep: Sweep,
    store: Store | None = None,
    engine: SweepEngine | None = None,
    progress: Progress = lambda done, total: None,
) -> Any:
    """A pyarrow.Table with a row for each item, in their order, bit for bit the same whichever engine computed it and
    however often it was interrupted: `key`, the columns of the function, and `error`.

    With a store every unit's rows are written when they come and those that are there are not computed again; without
    one they are kept in memory. Raises HandError; what was finished before stays in the store.
    """
    keys = sweep.keys()
    with store.open_for(sweep) if store is not None else nullcontext(MemoryStore()) as kept:
        units = sweep.units(keys, kept.keys())
        total = len(set(keys))
        done = total - sum(len(unit.keys) for unit in units)
        progress(done, total)
        with closing((engine or Local()).results(sweep, units)) as results:  # type: ignore[type-var]  # A generator.
            for number, rows in results:
                kept.add(unit_table(units[number].keys, rows, sweep.function))
                done += len(rows)
                progress(done, total)
        return ordered_table(kept.tables(), keys)
