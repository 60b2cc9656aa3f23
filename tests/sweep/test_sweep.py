"""A sweep gives a row for each item, in order, the same bits whoever computes it."""

from __future__ import annotations

import subprocess
import sys
import time
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from allegro_twin.errors import ConfigError, HandError
from allegro_twin.sweep import Local, Store, Sweep, run
from tests.sweep.work import as_bytes, calls, numbered

WAVES = "tests.sweep.work:waves"
ENGINES = [0, 2]


def sweep_of(function: str = "waves", count: int = 10, unit: int = 3, **shared: Any) -> Sweep:
    return Sweep(f"tests.sweep.work:{function}", numbered(count), shared, unit=unit)


@pytest.mark.slow
def test_the_table_is_the_same_to_the_bit_in_this_process_and_in_two_others(tmp_path: Path) -> None:
    sweep = sweep_of(count=100, unit=7)
    table = run(sweep, engine=Local(0))
    assert table["n"].to_pylist() == list(range(100))
    assert table.column_names == ["key", "n", "sine", "odd", "error"]
    assert as_bytes(run(sweep, engine=Local(2))) == as_bytes(table)
    for count in ENGINES:
        assert as_bytes(run(sweep, Store(tmp_path / str(count)), Local(count))) == as_bytes(table)
    parts = [{path.name: path.read_bytes() for path in (tmp_path / str(count)).iterdir()} for count in ENGINES]
    assert parts[0] == parts[1]


def test_rows_come_in_the_order_of_the_items_though_units_end_in_another() -> None:
    sweep = Sweep("tests.sweep.work:slower_first", numbered(6), unit=1)
    assert run(sweep, engine=Local(2))["n"].to_pylist() == list(range(6))


def test_an_item_that_is_there_twice_is_computed_once_and_has_two_rows(tmp_path: Path) -> None:
    log = tmp_path / "log"
    sweep = Sweep(WAVES, [{"n": 4}, {"n": 7}, {"n": 4}], {"log": str(log)})
    assert run(sweep, engine=Local(0))["n"].to_pylist() == [4, 7, 4]
    assert calls(log) == [[4, 7]]


@pytest.mark.parametrize("count", ENGINES)
def test_an_item_that_fails_has_the_text_of_its_error_and_the_others_have_their_rows(count: int) -> None:
    sweep = sweep_of("fussy", 10, unit=5, disliked=[3, 9])
    table = run(sweep, engine=Local(count))
    assert table["error"].to_pylist() == [*[None] * 3, "no 3, please", *[None] * 5, "no 9, please"]
    assert table["n"].to_pylist() == [0, 1, 2, None, 4, 5, 6, 7, 8, None]
    good = run(sweep_of("fussy", 10, unit=1, disliked=[3, 9]), engine=Local(0))
    assert as_bytes(good) == as_bytes(table)


def test_every_item_may_fail() -> None:
    table = run(sweep_of("fussy", 3, disliked=[0, 1, 2]), engine=Local(0))
    assert table.column_names == ["key", "error"]
    assert table["error"].null_count == 0


def test_progress_counts_items_and_begins_with_those_that_are_there(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    for _ in range(2):
        run(sweep_of(), Store(tmp_path / "s"), Local(0), lambda done, total: told.append((done, total)))
    assert told == [(0, 10), (3, 10), (6, 10), (9, 10), (10, 10), (10, 10)]


def test_a_column_of_whole_numbers_in_one_unit_and_others_in_the_next_is_of_floats() -> None:
    for unit in (1, 4, 10):
        table = run(sweep_of("mixed", 10, unit=unit, other=0.5), engine=Local(0))
        assert table["value"].to_pylist() == [0.0, 1.0, 2.0, 3.0, 4.0, *[0.5] * 5]
        assert str(table["value"].type) == "double"


def test_memory_does_not_grow_with_the_rows_that_are_written(tmp_path: Path) -> None:
    held: list[int] = []
    sweep = sweep_of("wide", 60, unit=5)
    store = Store(tmp_path / "s")
    tracemalloc.start()
    with store.open_for(sweep):
        pass
    with pytest.raises(KeyboardInterrupt):
        run(sweep, store, Local(0), lambda done, total: held.append(interrupted_at(done, total)))
    tracemalloc.stop()
    assert len(list((tmp_path / "s").glob("*.parquet"))) == 12
    assert max(held[3:]) < held[2] + 300_000  # Three rows of the fifty that have come since.


def interrupted_at(done: int, total: int) -> int:
    """The memory that is held; at the end an interruption, before the table is read."""
    if done == total:
        raise KeyboardInterrupt
    return tracemalloc.get_traced_memory()[0]


@pytest.mark.parametrize("count", ENGINES)
@pytest.mark.parametrize(
    ("sweep", "message"),
    [
        (sweep_of("too_few", 3), "tests.sweep.work:too_few gave 2 rows for 3 items; it must give one for each"),
        (sweep_of("named_otherwise", 3, name="m"), "every row must have the same names; ['m', 'n'] differ"),
        (sweep_of("mixed", unit=10, other="text"), "column 'value'"),
        (sweep_of("mixed", unit=5, other="text"), "rows of a sweep do not fit each other"),
        (sweep_of("wavse"), "no function of tests.sweep.work named 'wavse'; did you mean 'waves'"),
        (Sweep("waves", numbered(1)), "function 'waves': must be package.module:name"),
        (Sweep("no.such:waves", numbered(1)), "function 'no.such:waves': No module named 'no'"),
    ],
)
def test_what_a_function_does_wrong_is_one_line(count: int, sweep: Sweep, message: str) -> None:
    with pytest.raises(ConfigError) as raised:
        run(sweep, engine=Local(count))
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


def test_what_cannot_be_swept_is_refused_beforehand() -> None:
    with pytest.raises(ConfigError, match=f"a sweep of {WAVES} without items: there is nothing to compute"):
        Sweep(WAVES, [])
    with pytest.raises(ConfigError, match="a sweep's unit must be 1 item or more, not 0"):
        Sweep(WAVES, numbered(1), unit=0)
    with pytest.raises(ConfigError, match="item 1 of a sweep: not plain data: Object of type object"):
        run(Sweep(WAVES, [{"n": 1}, {"n": object()}]))
    with pytest.raises(ConfigError, match="shared data of a sweep: not plain data: Out of range float"):
        run(Sweep(WAVES, numbered(1), {"scale": float("nan")}))
    with pytest.raises(ConfigError, match="processes must be 0 or more, not -1"):
        Local(-1)


@pytest.mark.slow
def test_a_process_that_is_killed_is_replaced_and_its_unit_tried_again(tmp_path: Path) -> None:
    log = tmp_path / "log"
    sweep = sweep_of("fatal", 10, marks=str(tmp_path / "marks"), at=4, times=2, log=str(log))
    table = run(sweep, Store(tmp_path / "s"), Local(2))
    assert table["n"].to_pylist() == list(range(10))
    assert sorted(calls(log)) == [[0, 1, 2], [3, 4, 5], [6, 7, 8], [9]]


@pytest.mark.slow
def test_a_unit_whose_process_is_killed_three_times_is_named(tmp_path: Path) -> None:
    sweep = sweep_of("fatal", 10, marks=str(tmp_path / "marks"), at=9, times=3)
    with pytest.raises(HandError) as raised:
        run(sweep, Store(tmp_path / "s"), Local(1))
    assert str(raised.value) == (
        "tests.sweep.work:fatal, item 9: its process was killed by signal 9, 3 times; what is finished stays"
    )
    assert len(Store(tmp_path / "s").keys()) == 9


def test_a_mistake_in_a_function_is_not_tried_again(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(HandError, match="items 0 to 2: its process ended with code 1; what is finished stays"):
        run(sweep_of("broken", 3), engine=Local(1))
    shown = capfd.readouterr().err
    assert shown.count("ZeroDivisionError: as a mistake in a function does") == 1


@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for its workers in /proc")
def test_workers_end_in_the_middle_of_a_task_when_what_started_them_is_killed(tmp_path: Path) -> None:
    log, program = tmp_path / "log", (
        "import sys\nfrom allegro_twin.sweep.jobs import Sweep\nfrom allegro_twin.sweep.local import Local\n"
        "from allegro_twin.sweep.runner import run\n"
        "run(Sweep('tests.sweep.work:waves', [{'n': 0}, {'n': 1}], {'log': sys.argv[1], 'seconds': 600.0}, unit=1),"
        " engine=Local(2))\n"
    )  # fmt: skip
    begun = subprocess.Popen([sys.executable, "-c", program, str(log)], cwd=Path(__file__).parents[2])
    while not log.exists() or log.read_text().count("\n") < 2:
        assert begun.poll() is None
        time.sleep(0.05)
    children = Path(f"/proc/{begun.pid}/task/{begun.pid}/children").read_text().split()
    begun.kill()
    begun.wait()
    assert len(children) >= 2
    deadline = time.monotonic() + 60.0
    while any("sweep.worker" in command_of(child) for child in children):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def command_of(process: str) -> str:
    """Empty once it has ended."""
    try:
        return Path(f"/proc/{process}/cmdline").read_text()
    except OSError:
        return ""
