"""Several runs side by side are the same runs, to the bit; they end together."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from allegro_twin.app import session
from allegro_twin.app.session import RunOutcome
from allegro_twin.errors import HandError, HandFault
from allegro_twin.files.output_folder import FILES, UNFINISHED
from allegro_twin.grasping.verdict import faulted
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.recording.reader import load
from allegro_twin.surfaces.cli.start import parallel
from allegro_twin.sweep import workers
from tests.patience import comes_true
from tests.surfaces.cli.conftest import Run
from tests.test_safety import state

SUITE = Path(__file__).resolve().parents[3]
MINUTES = "backend: {kind: sim}\ntask: {posture: home}\ncontroller: {kind: pd}\nseconds: 600\n"
MOMENT = MINUTES.replace("600", "0.3").replace("task: {posture: home}\n", "")  # Which it could not reach.
TOO_FAST = "backend: {kind: sim}\ncontroller: {kind: torque, torque: 0.3}\nlimits: {velocity: 0.5}\nseconds: 1\n"


def written(folder: Path, **contents: str) -> list[str]:
    paths = [folder / f"{name}.yaml" for name in contents]
    for path, text in zip(paths, contents.values(), strict=True):
        path.write_text(text)
    return [str(path) for path in paths]


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.mark.slow
def test_recordings_pictures_and_report_are_the_same_bytes_whether_in_one_process_or_in_two(
    tmp_path: Path, command: Run
) -> None:
    quick = (SUITE / "conf/protocols/table_pick.yaml").read_text().replace("4.5, shake", "0.3, shake")
    (tmp_path / "quick.yaml").write_text(quick.replace("seconds: 2.0", "seconds: 0.3"))
    lemon = (SUITE / "scenarios/demo/lemon.yaml").read_text() + f"protocol: {tmp_path}/quick.yaml\n"
    shown = []
    for count in (1, 2):
        out = tmp_path / str(count)
        code, table, errors = command(
            "run", *written(tmp_path, lemon=lemon), "--side", "both", "--out", out, "--jobs", count
        )
        assert errors == ""
        shown.append((code, table.replace(str(out), "OUT")))
    assert shown[0] == shown[1]
    one, two = files(tmp_path / "1"), files(tmp_path / "2")
    assert {"lemon_left.arrow", "lemon_right.arrow", "report.json"} <= set(one)
    assert one.keys() == two.keys()
    assert [name for name in one if one[name] != two[name]] == []


@pytest.mark.slow
def test_what_is_shown_comes_in_the_order_that_was_asked_for_whichever_ends_first(tmp_path: Path, command: Run) -> None:
    paths = written(tmp_path, long=MOMENT.replace("0.3", "3.0"), short=MOMENT)
    code, shown, _ = command("run", *paths, "--jobs", 2)
    assert code == 0
    assert shown.index("at 3.000 s") < shown.index("at 0.300 s")


@pytest.mark.slow
def test_the_error_of_the_earliest_run_is_told_as_if_they_had_come_one_after_the_other(
    tmp_path: Path, command: Run
) -> None:
    late = TOO_FAST.replace("torque: 0.3}", "torque: 0.05}")
    paths = written(tmp_path, fine=MOMENT, late=late, at_once=TOO_FAST)
    assert command("run", paths[1])[2] != command("run", paths[2])[2]
    answers = [command("run", *paths, "--out", tmp_path / "out", "--jobs", count) for count in (1, 3)]
    assert answers[0] == answers[1]
    assert answers[0][0] == 4
    assert answers[0][2].count("\n") == 1


def test_only_simulated_hands_run_side_by_side(tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    bus = MOMENT.replace("{kind: sim}", "{kind: can, version: v4, interface: allegro-virtual, gravity: [0, 0, -9.81]}")
    paths = written(tmp_path, a=MOMENT, b=bus)
    monkeypatch.setattr(parallel, "_run_parallel", None)
    assert command("run", *paths, "--jobs", 2)[0] == 0


def children(program: int) -> list[int]:
    return [int(each) for each in Path(f"/proc/{program}/task/{program}/children").read_text().split()]


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def within(seconds: float, true: Callable[[], bool]) -> bool:
    return comes_true(true, seconds)


@contextmanager
def two_running(folder: Path) -> Iterator[tuple[subprocess.Popen[str], list[int]]]:
    """A program with two runs of minutes in the middle of them, and its processes."""
    paths = written(folder, a=MINUTES, b=MINUTES)
    allegro = [sys.executable, "-m", "allegro_twin", "run", *paths, "--out", str(folder / "out"), "--jobs", "2"]
    program = subprocess.Popen(allegro, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        recordings = [folder / "out" / UNFINISHED / name for name in ("a.arrow", "b.arrow")]
        assert within(60, lambda: all(path.exists() and path.stat().st_size > 100_000 for path in recordings))
        yield program, children(program.pid)
    finally:
        program.kill()
        program.communicate()


@pytest.mark.slow
@pytest.mark.parametrize("signalled", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)])
def test_an_interruption_ends_all_processes_and_their_recordings_are_whole(
    tmp_path: Path, signalled: signal.Signals
) -> None:
    with two_running(tmp_path) as (program, workers):
        assert len(workers) == 2
        program.send_signal(signalled)
        _, errors = program.communicate()
    out = tmp_path / "out" / UNFINISHED
    assert program.returncode == 128 + signalled
    counted, kept = errors.splitlines()
    assert counted == "interrupted: 0 of 2 runs had ended"
    assert kept == f"what was written until then is in {out}; the rest of {out.parent} is as it was"
    assert not any(alive(worker) for worker in workers)
    assert [path.name for path in out.parent.iterdir()] == [UNFINISHED]  # It was no run.
    assert {path.name for path in out.iterdir()} == {"a.arrow", "b.arrow", FILES}  # And nothing begun or half-written.
    assert all(len(load(out / name)) > 100 for name in ("a.arrow", "b.arrow"))


def test_processes_end_with_the_program_that_started_them_even_if_it_is_killed(tmp_path: Path) -> None:
    with two_running(tmp_path) as (program, workers):
        program.kill()
        assert within(30, lambda: not any(alive(worker) for worker in workers))


@pytest.mark.slow
def test_a_run_whose_process_is_killed_is_one_line_that_names_it(tmp_path: Path) -> None:
    with two_running(tmp_path) as (program, workers):
        for worker in workers:
            os.kill(worker, signal.SIGKILL)
        _, errors = program.communicate()
    assert program.returncode == 2
    said = "allegro-twin: a, right hand: its process was killed by signal 9; --jobs 1 runs it in this one; what was"
    assert errors.startswith(said)
    assert errors.count("\n") == 1


@pytest.mark.parametrize("count", [1, 2])
def test_a_hand_that_the_guard_stops_in_a_trial_has_not_held_and_the_others_go_on(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    def perform(rig: Any, config: Any, *_: object) -> RunOutcome:
        last = state()
        if Path(config.task.scenario).stem == "a":
            error = HandFault("stopped: ring_0 moves at 12.03 rad/s, over its limit; reset to go on")
            error.history = (SimpleNamespace(state=last),)
            raise error
        return RunOutcome(last, replace(faulted(""), held=True), ())

    lemon = (SUITE / "scenarios/demo/lemon.yaml").read_text()
    paths = written(tmp_path, a=lemon, b=lemon)
    monkeypatch.setattr(session, "perform", perform)
    code, shown, said = command("run", *paths[:count], "--jobs", 1, "--out", tmp_path / "out")
    assert (code, said) == (5, "")
    assert "guard: ring_0 moves at 12.03 rad/s, over its limit" in shown
    assert "reset to go on" not in shown
    assert "a, right" in shown
    report = json.loads((tmp_path / "out" / "report.json").read_text())["trials"]
    assert [each["held"] for each in report.values()] == [False, True][:count]


LEMON = (SUITE / "scenarios/demo/lemon.yaml").read_text()


@pytest.mark.parametrize("folder", [False, True])
@pytest.mark.parametrize("error", [KeyboardInterrupt(), HandError("the disk burns")])
def test_what_ends_several_runs_does_not_lose_the_verdicts_of_those_that_had_ended(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch, error: BaseException, folder: bool
) -> None:
    def perform(rig: Any, config: Any, *_: object) -> RunOutcome:
        if Path(config.task.scenario).stem == "c":
            raise error
        return RunOutcome(state(), replace(faulted("it slipped"), held=Path(config.task.scenario).stem == "a"), ())

    paths = written(tmp_path, a=LEMON, b=LEMON, c=LEMON, d=LEMON)
    monkeypatch.setattr(session, "perform", perform)
    out = tmp_path / "out"
    code, shown, said = command("run", *paths, "--jobs", 1, *(["--out", out] if folder else []))
    said = " ".join(said.split())
    assert "1 of 2 held" in shown
    assert "b, right: it slipped" in shown
    assert "2 of 4 runs had ended" in said
    assert code == (130 if isinstance(error, KeyboardInterrupt) else 2)
    if folder:
        trials = json.loads((out / UNFINISHED / "report.json").read_text())["trials"]
        assert {name: trial["held"] for name, trial in trials.items()} == {"a_right": True, "b_right": False}


def test_what_had_ended_before_its_turn_is_told_too_when_runs_side_by_side_are_interrupted(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    class TwoAtOnce(workers.Workers):
        """The first run goes on and the second has ended when Ctrl-C comes."""

        def give(self, task: int, content: Any) -> None:
            self.given = task

        @property
        def free(self) -> int:
            return 1 - getattr(self, "given", -1)

        def events(self) -> Iterator[workers.UnitDone]:
            outcome = RunOutcome(state(), replace(faulted(""), held=True), ())
            yield workers.UnitDone(1, parallel.RunResult(load_spec(), outcome, "pinch"))
            raise KeyboardInterrupt

    monkeypatch.setattr(workers, "Workers", TwoAtOnce)
    code, shown, said = command("run", *written(tmp_path, a=LEMON, b=LEMON, c=LEMON), "--jobs", 2)
    assert (code, "b, right hand: not held:" in shown) == (130, True)
    assert "interrupted: 1 of 3 runs had ended" in " ".join(said.split())
