"""Computation of one unit: in this process, in another, or on another computer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any, NamedTuple

from allegro_twin.errors import ConfigError, HandError, unknown
from allegro_twin.files.fingerprints import source_fingerprint
from allegro_twin.sweep.jobs import Item, Result, Sweep, versions


def find_function(name: str) -> Callable[..., Any]:
    """The function of that name. Raises ConfigError where there is none."""
    module, _, attribute = name.partition(":")
    if not module or not attribute:
        raise ConfigError(f"function {name!r}: must be package.module:name")
    try:
        home = import_module(module)
    except ModuleNotFoundError as error:
        raise ConfigError(f"function {name!r}: {error}") from error
    found: Callable[..., Any] | None = getattr(home, attribute, None)
    if not callable(found):
        known = [each for each, value in vars(home).items() if callable(value) and not each.startswith("_")]
        raise ConfigError(unknown(f"function of {module}", attribute, known))
    return found


class UnitTask(NamedTuple):
    """The part of a task that all units of a sweep share."""

    function: str
    shared: Mapping[str, Any]
    versions: Mapping[str, str]
    """Versions on the computer that asks; those on the one that computes must be equal."""


def unit_task(sweep: Sweep, *, elsewhere: bool = False) -> UnitTask:
    """`elsewhere`: another computer, whose sources may be others."""
    return UnitTask(sweep.function, sweep.shared, versions() | (_code(sweep.function) if elsewhere else {}))


def _code(function: str) -> dict[str, str]:
    return {"code": source_fingerprint(function.partition(":")[0])}


def compute(work: UnitTask, items: Sequence[Item]) -> list[Result]:
    """The row of every item. Where the function raises HandError the unit is halved until the item is found, whose
    result is then the error's text. Raises ConfigError for other versions, or rows that are not one for an item."""
    mine = versions() | (_code(work.function) if "code" in work.versions else {})
    if mine != work.versions:
        raise ConfigError(f"a sweep of {_said(work.versions)} came to a computer with {_said(mine)}")
    return _rows(find_function(work.function), work, list(items))


def compute_in_worker(work: UnitTask, items: Sequence[Item], tell: Callable[[object], None]) -> list[Result]:
    """`compute` as the task of a worker process, without messages."""
    return compute(work, items)


def _rows(call: Callable[..., Any], work: UnitTask, items: list[Item]) -> list[Result]:
    try:
        rows: list[Result] = call(work.shared, items)
    except HandError as error:
        if len(items) == 1:
            return [" ".join(str(error).split())]
        middle = len(items) // 2
        return _rows(call, work, items[:middle]) + _rows(call, work, items[middle:])
    if len(rows) != len(items):
        raise ConfigError(f"{work.function} gave {len(rows)} rows for {len(items)} items; it must give one for each")
    return rows


def _said(stamps: Mapping[str, str]) -> str:
    code = f" of sources {stamps['code']}" if "code" in stamps else ""
    return f"{stamps['engine']} and allegro_twin {stamps['allegro_twin']}{code}"
