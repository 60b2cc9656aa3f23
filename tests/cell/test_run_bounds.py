"""Every state of the cell is bounded in the cell's own time: whatever exit is taken away, a run ends."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from allegro_twin.backend import HandBackend
from allegro_twin.cell import run as plain
from allegro_twin.cell import states
from allegro_twin.cell.arm.faults import SilentBackend
from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.run import perform, state_rules
from allegro_twin.types import HandState, Sample
from tests.cell.test_run import SETTINGS, cell_of

SHORT: dict[str, Any] = {
    "timeouts": dict.fromkeys(("security", "look", "target", "approach", "close", "lift", "check"), 0.3),
    "arm": SETTINGS.arm.model_dump() | {"approach": 0.3, "lift": 0.3},
    "validation": SETTINGS.validation.model_dump() | {"tare": 100, "long": 100},
    "decide": {"by": "event", "retries": 0},
}
"""A cell that is late everywhere."""


class Hang(Exception):
    """A run that should be over by the count of its periods."""


def bounded(cell: Cell) -> Callable[[Iterable[Sample]], Iterator[Sample]]:
    """A stage that knows nothing of states: a little more samples than the longest run has."""
    most = round((state_rules(cell.settings).longest + 1.0) / min(cell.arm.period, cell.hand.period))

    def stage(samples: Iterable[Sample]) -> Iterator[Sample]:
        for count, sample in enumerate(samples):
            if count > most:
                raise Hang
            yield sample

    return stage


class Standing(SilentBackend):
    """A device whose clock stands still from a tick on."""

    def __init__(self, inner: HandBackend, at: int) -> None:
        super().__init__(inner, np.inf)
        self._tick = at
        self._last: HandState | None = None

    def read(self) -> HandState:
        if self._last is None or self._last.tick < self._tick:
            self._last = super().read()
        return self._last


@pytest.mark.parametrize("device", ["arm", pytest.param("hand", marks=pytest.mark.slow)])
def test_a_clock_that_stands_still_ends_in_a_fault_by_its_name(device: str) -> None:
    cell = cell_of(**SHORT)
    stopped = Standing(cell.arm if device == "arm" else cell.hand, 20)
    cell = replace(cell, arm=stopped) if device == "arm" else replace(cell, hand=stopped)
    stage = bounded(cell)
    report = perform(cell, arm=stage, hand=stage)
    assert str(report.end) == "fault: endless"
    assert f"of the {device}'s periods" in report.end.sentence


def test_a_clock_that_stands_still_does_not_hold_up_the_end_after_the_other_has_fallen_silent() -> None:
    cell = cell_of(**SHORT)
    report = perform(replace(cell, arm=SilentBackend(cell.arm, 0.1), hand=Standing(cell.hand, 40)), hand=bounded(cell))
    assert str(report.end) == "fault: arm silent"


def test_a_run_may_last_as_long_as_all_its_states_in_every_try() -> None:
    rules = state_rules(SETTINGS)
    once = sum(most for name, most in rules.timeouts.items() if name != "ToReleasePose")
    assert rules.longest > (rules.retries + 1) * once + rules.timeouts["Validate"]


def test_a_table_of_objects_may_take_as_long_as_each_of_them_after_each_that_was_put_away() -> None:
    rules = replace(state_rules(SETTINGS), objects=3)  # Three, then two, then one are left to be tried; a last look.
    assert rules.longest > 7 * (rules.retries + 1) * sum(rules.timeouts.values()) + rules.timeouts["Validate"]


def exits(source: str, function: str) -> list[int]:
    """Which statements of a function lead on or out: by their place among all of it, in the order of `ast.walk`."""
    kinds = (ast.Break, ast.If) if function == "perform" else (ast.If, ast.Return)
    return [k for k, node in enumerate(ast.walk(body_of(ast.parse(source), function))) if isinstance(node, kinds)]


def body_of(tree: ast.Module, function: str) -> ast.FunctionDef:
    return next(node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == function)


def without(source: str, function: str, place: int) -> str:
    """A module in which one exit of a function is taken away: a `break` goes on, an `if` is never so, a `return` of the
    state machine stays where it is."""
    tree = ast.parse(source)
    node = list(ast.walk(body_of(tree, function)))[place]
    if isinstance(node, ast.If):
        node.test = ast.Constant(False)
    elif isinstance(node, ast.Return):
        node.value = ast.Name("now", ast.Load())
    else:
        for parent in ast.walk(tree):
            for part in ("body", "orelse"):
                row = getattr(parent, part, [])
                if isinstance(row, list) and node in row:
                    row[row.index(node)] = ast.Pass()
    return ast.unparse(ast.fix_missing_locations(tree))


def module_of(source: str, name: str) -> ModuleType:
    made = ModuleType(name)
    sys.modules[name] = made
    exec(compile(source, name, "exec"), made.__dict__)
    return made


def sources() -> dict[str, str]:
    found = {}
    for module in (plain, states):
        assert module.__file__ is not None
        with open(module.__file__) as file:
            found[module.__name__] = file.read()
    return found


SOURCES = sources()
PERFORM = exits(SOURCES[plain.__name__], "perform")
DECIDED = [(name, place) for name in ("next_state", "watch_outcome", "_again", "ended")
           for place in exits(SOURCES[states.__name__], name)]  # fmt: skip
QUICK = 3


def ends(cell: Cell, runner: ModuleType) -> None:
    """It ends, whichever way, and says nothing false."""
    try:
        stage = bounded(cell)
        report = runner.perform(cell, arm=stage, hand=stage)
    except Hang:
        raise
    except Exception:  # noqa: BLE001  # Whatever a mutant breaks down with is a failure too.
        return
    finally:
        cell.close()
    assert report.is_lifted or report.end.kind != "held"


def rows(places: list[Any]) -> list[Any]:
    """The first in every run of the tests, all in the long one."""
    return [place if k < QUICK else pytest.param(place, marks=pytest.mark.long) for k, place in enumerate(places)]


@pytest.mark.parametrize("place", rows(PERFORM))
@pytest.mark.parametrize("changes", [SHORT, pytest.param({}, marks=pytest.mark.long)])
def test_a_loop_without_one_of_its_exits_ends(place: int, changes: dict[str, Any]) -> None:
    mutant = module_of(without(SOURCES[plain.__name__], "perform", place), "tests.cell.mutant_run")
    ends(cell_of(**changes), mutant)


@pytest.mark.parametrize("place", rows(DECIDED))
@pytest.mark.parametrize("changes", [SHORT, pytest.param({}, marks=pytest.mark.long)])
def test_a_state_machine_without_one_of_its_exits_ends(
    place: tuple[str, int], changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = module_of(without(SOURCES[states.__name__], *place), "tests.cell.mutant_states")
    for name in ("next_state", "watch_outcome"):
        monkeypatch.setattr(plain, name, getattr(machine, name))
    ends(cell_of(**changes), plain)
