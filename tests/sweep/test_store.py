"""A sweep that was interrupted goes on where it was, in a folder that is of this sweep and no other."""

from __future__ import annotations

import json
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.sweep import Local, Store, Sweep, run
from allegro_twin.sweep.table import read_results, write_results
from tests.sweep.test_sweep import WAVES, sweep_of
from tests.sweep.work import as_bytes, calls, numbered

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """
import json, sys
from allegro_twin.sweep import Local, Store, Sweep, run
from tests.sweep.work import numbered
log, folder, processes = sys.argv[1:]
sweep = Sweep("tests.sweep.work:waves", numbered(20), {"log": log, "seconds": 0.1}, unit=2)
run(sweep, Store(folder), Local(int(processes)))
"""


def started(log: Path, folder: Path, processes: int) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-c", PROGRAM, log, folder, str(processes)], cwd=ROOT)


@pytest.mark.slow
@pytest.mark.parametrize("processes", [0, 2])
def test_a_sweep_that_is_killed_goes_on_and_repeats_only_what_was_in_flight(tmp_path: Path, processes: int) -> None:
    log, folder = tmp_path / "log", tmp_path / "s"
    program = started(log, folder, processes)
    while len(list(folder.glob("part-*"))) < 4 and program.poll() is None:
        time.sleep(0.01)
    program.kill()
    program.wait()
    time.sleep(0.5)  # A process that was computing writes its last line.
    finished = {n for path in folder.glob("part-*") for n in pq.read_table(path)["n"].to_pylist()}
    before = calls(log)
    assert 8 <= len(finished) < 20
    sweep = Sweep(WAVES, numbered(20), {"log": str(log), "seconds": 0.1}, unit=2)
    table = run(sweep, Store(folder), Local(processes))
    after = calls(log)[len(before) :]
    assert finished.isdisjoint({n for call in after for n in call})
    assert sum(map(len, after)) == 20 - len(finished)
    assert len(before) - len(finished) // 2 <= max(processes, 1)
    assert as_bytes(table) == as_bytes(run(sweep, engine=Local(0)))


def test_a_sweep_that_was_done_computes_nothing_and_a_longer_one_only_what_is_new(tmp_path: Path) -> None:
    log = tmp_path / "log"
    store = Store(tmp_path / "s")
    short, longer = (sweep_of(count=count, log=str(log)) for count in (4, 6))
    first = run(short, store, Local(0))
    assert as_bytes(run(short, store, Local(0))) == as_bytes(first)
    assert calls(log) == [[0, 1, 2], [3]]
    table = run(longer, store, Local(0))
    assert table["n"].to_pylist() == list(range(6))
    assert calls(log)[2:] == [[4, 5]]
    assert as_bytes(run(short, store, Local(0))) == as_bytes(first)


def test_a_key_depends_on_all_that_a_row_depends_on_and_on_nothing_else() -> None:
    item = {"n": 1, "m": 2}
    key = Sweep(WAVES, [item]).keys()
    assert Sweep(WAVES, [{"m": 2, "n": 1}], unit=5).keys() == key
    others = [
        Sweep(WAVES, [{"n": 1, "m": 3}]),
        Sweep(WAVES + "s", [item]),
        Sweep(WAVES, [item], {"seed": 1}),
        Sweep(WAVES, [item], stamps={"protocol": "2"}),
        Sweep(WAVES, [item], inputs=[{"grasp": "1"}]),
        Sweep(WAVES, [item], inputs=[{"grasp": "2"}]),
    ]
    assert len({each.keys()[0] for each in others} | set(key)) == 7


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (sweep_of("fussy", disliked=[]), "function tests.sweep.work:waves there, tests.sweep.work:fussy here; shared"),
        (Sweep(WAVES, numbered(3), stamps={"protocol": "2"}), "protocol none there, 2 here"),
    ],
)
def test_the_folder_of_another_sweep_is_refused_by_the_difference(tmp_path: Path, other: Sweep, named: str) -> None:
    run(sweep_of(), Store(tmp_path / "s"), Local(0))
    with pytest.raises(ConfigError) as raised:
        run(other, Store(tmp_path / "s"), Local(0))
    assert f"{tmp_path / 's'} is of another sweep: {named}" in str(raised.value)
    assert str(raised.value).endswith("; give another folder")
    assert "\n" not in str(raised.value)


def test_a_manifest_says_what_is_asked_and_what_the_answers_are_made_of(tmp_path: Path) -> None:
    run(sweep_of(seed=7), Store(tmp_path), Local(0))
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert set(manifest) == {"format", "function", "shared", "made_of", "data"}
    assert set(manifest["made_of"]) == {"engine", "allegro_twin", "code"}
    assert manifest["data"] == {"seed": 7}


def fed(*fed_with: str, log: Path) -> Sweep:
    """An item for each input."""
    inputs = [{"grasp": each, "hand": "h"} for each in fed_with]
    return Sweep(WAVES, numbered(len(fed_with)), {"log": str(log)}, 2, inputs=inputs)


def test_rows_whose_inputs_changed_are_made_again_the_others_stay_and_none_is_lost(tmp_path: Path) -> None:
    log, folder, told = tmp_path / "log", tmp_path / "s", list[str]()
    store = Store(folder, told.append)
    first = run(fed("a", "b", "c", log=log), store, Local(0))
    again = run(fed("a", "b", "d", log=log), store, Local(0))
    assert calls(log) == [[0, 1], [2], [2]]
    assert told == [
        f"{folder}: 1 rows were made with another grasp: they are made again; the old ones are in {folder}/replaced/1"
    ]
    assert again["key"].to_pylist()[:2] == first["key"].to_pylist()[:2]
    assert store.content().table.num_rows == 3
    old = Store(folder / "replaced" / "1").content()
    assert old.table["n"].to_pylist() == [2]
    assert old.stamps["grasp"] == "a b c"
    mixed = run(fed("a", "e", "d", log=log), store, Local(0))  # A part of which one row stays.
    assert calls(log)[3:] == [[1]]
    assert mixed["n"].to_pylist() == [0, 1, 2]
    assert sorted(store.content().table["n"].to_pylist()) == [0, 1, 2]
    assert len(told) == 2
    run(fed("a", "e", "d", log=log), store, Local(0))
    assert len(told) == 2
    assert len(calls(log)) == 4


@pytest.mark.parametrize("changed", [{"engine": "mujoco 3.9.0"}, {"code": "0123"}, {"allegro_twin": "0.0.9"}])
def test_another_engine_or_other_code_make_all_rows_again(tmp_path: Path, changed: dict[str, str]) -> None:
    log, folder, told = tmp_path / "log", tmp_path / "s", list[str]()
    sweep = fed("a", "b", log=log)
    was = {"engine": "", "code": "", "allegro_twin": ""} | changed
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Sweep, "_common", lambda self: was)
        run(sweep, Store(folder), Local(0))
    run(sweep, Store(folder, told.append), Local(0))
    assert calls(log) == [[0, 1], [0, 1]]
    assert len(told) == 1
    assert "2 rows were made with another" in told[0]
    assert Store(folder / "replaced" / "1").content().table.num_rows == 2


def test_a_renewal_that_was_cut_off_is_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log, folder = tmp_path / "log", tmp_path / "s"
    run(fed("a", "b", "c", log=log), Store(folder), Local(0))
    with monkeypatch.context() as patch:
        patch.setattr(Store, "_hold", lambda *_: None)
        patch.setattr("allegro_twin.sweep.store.json.dumps", lambda *_, **__: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            run(fed("a", "x", "c", log=log), Store(folder), Local(0))
    table = run(fed("a", "x", "c", log=log), Store(folder), Local(0))
    assert table["n"].to_pylist() == [0, 1, 2]
    assert calls(log)[2:] == [[1]]


@pytest.mark.parametrize("text", ["", "{", "7", "[1]", "\x00"])
def test_a_manifest_that_is_none_is_one_line(tmp_path: Path, text: str) -> None:
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(RecordingError, match=r"manifest\.json: cannot be read: .*; sweep into another folder"):
        run(sweep_of(), Store(tmp_path), Local(0))


def test_a_folder_with_other_things_in_it_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(ConfigError, match=r"has files but no manifest\.json, so no sweep's; give an empty folder"):
        run(sweep_of(), Store(tmp_path), Local(0))


def test_two_programs_do_not_sweep_into_one_folder(tmp_path: Path) -> None:
    with (
        Store(tmp_path).open_for(sweep_of()),
        pytest.raises(ConfigError, match="another program sweeps into it; wait for it to end"),
    ):
        run(sweep_of(), Store(tmp_path), Local(0))


def test_a_part_that_cannot_be_read_is_named_and_computed_again_once_it_is_deleted(tmp_path: Path) -> None:
    table = run(sweep_of(), Store(tmp_path), Local(0))
    part = next(iter(tmp_path.glob("part-*")))
    part.write_bytes(part.read_bytes()[:-10])
    with pytest.raises(RecordingError, match="delete it, and its items are computed again") as raised:
        run(sweep_of(), Store(tmp_path), Local(0))
    assert str(part) in str(raised.value)
    part.unlink()
    assert as_bytes(run(sweep_of(), Store(tmp_path), Local(0))) == as_bytes(table)


def test_what_a_killed_program_was_writing_is_cleared_away(tmp_path: Path) -> None:
    run(sweep_of(), Store(tmp_path), Local(0))
    (tmp_path / ".part-1.7.parquet").write_bytes(b"half")
    run(sweep_of(), Store(tmp_path), Local(0))
    assert not list(tmp_path.glob(".*"))


def test_a_sweep_goes_on_in_a_folder_whose_name_is_not_utf8(tmp_path: Path) -> None:
    folder = tmp_path / "n\udce4me"
    found = run(sweep_of(), Store(folder), Local(0))
    assert run(sweep_of(), Store(folder), Local(0)) == found
    write_results(folder / "all.parquet", found, {"of": "sweep"}, {})
    assert read_results(folder / "all.parquet")[1] == {"of": "sweep"}


def test_a_full_disk_is_one_line_and_what_was_finished_stays(tmp_path: Path) -> None:
    small, wide = sweep_of(count=4, unit=2), tmp_path / "s"
    limits: Any = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill(done: int, total: int) -> None:
        if done == 2:
            resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))

    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        with pytest.raises(RecordingError) as raised:
            run(small, Store(wide), Local(0), fill)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    assert f"cannot write {wide}/part-" in str(raised.value)
    assert str(raised.value).endswith("File too large")
    assert len(Store(wide).keys()) == 2
    assert run(small, Store(wide), Local(0))["n"].to_pylist() == [0, 1, 2, 3]
