"""An output folder is one run or none, and one program writes into it at a time."""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from allegro_twin.errors import RecordingError
from allegro_twin.files import output_folder
from allegro_twin.files.assets import data_root
from allegro_twin.files.output_folder import (
    FILES,
    UNFINISHED,
    add_to_run,
    defer_signals,
    files_changed_by_hand,
    lock_folder,
    write_run,
)
from allegro_twin.recording.reader import load
from allegro_twin.surfaces.cli import options
from tests.surfaces.cli.conftest import Run
from tests.surfaces.cli.wrong import built

POSE = "backend: {kind: sim}\ntask: {posture: home}\ncontroller: {kind: pd}\nseconds: 3\n"


def content(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


HOLDER = """
import sys
from pathlib import Path
from allegro_twin.files.output_folder import lock_folder
with lock_folder(Path(sys.argv[1])):
    print(1, flush=True)
    sys.stdin.read()
"""
RECORDER = """
import fcntl, sys
file = open(sys.argv[1], "ab")
fcntl.flock(file, fcntl.LOCK_EX)
print(1, flush=True)
sys.stdin.read()
"""


@contextmanager
def another_writer(path: Path, code: str = HOLDER) -> Iterator[None]:
    """A program that holds the lock of a folder, or of a file."""
    with subprocess.Popen([sys.executable, "-c", code, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as program:
        assert program.stdout is not None
        program.stdout.readline()
        yield
        program.kill()


@pytest.fixture(scope="module")
def lemon(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run, of a lemon that is neither held nor shaken for long."""
    folder = tmp_path_factory.mktemp("lemon")
    rules = (data_root() / "conf/protocols/table_pick.yaml").read_text().replace("4.5, shake", "0.3, shake")
    (folder / "quick.yaml").write_text(rules.replace("seconds: 2.0", "seconds: 0.3"))
    text = (data_root() / "scenarios/demo/lemon.yaml").read_text() + f"protocol: {folder}/quick.yaml\n"
    (folder / "lemon.yaml").write_text(text)
    command = [sys.executable, "-m", "allegro_twin", "run", str(folder / "lemon.yaml"), "--out", str(folder / "f")]
    subprocess.run(command, check=True)
    return folder / "f"


def rows(path: Path) -> int:
    """How many rows of a recording are on disk, whole."""
    try:
        return len(load(path, partial=True))
    except RecordingError:
        return 0


def interrupted(arguments: list[str], folder: Path, how: signal.Signals) -> tuple[int, str]:
    """A run that is stopped once its recording has rows."""
    with subprocess.Popen(
        [sys.executable, "-m", "allegro_twin", *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as program:
        while not any(rows(path) >= 100 for path in (folder / UNFINISHED).glob("*.arrow")):
            assert program.poll() is None, program.stderr and program.stderr.read()
            time.sleep(0.02)
        program.send_signal(how)
        _, said = program.communicate()
    return program.returncode, said


@pytest.mark.parametrize(
    "how", [signal.SIGINT, *(pytest.param(each, marks=pytest.mark.slow) for each in (signal.SIGTERM, signal.SIGKILL))]
)
def test_a_run_that_is_stopped_leaves_the_run_before_it_as_it_was(
    lemon: Path, tmp_path: Path, how: signal.Signals
) -> None:
    out = tmp_path / "f"
    shutil.copytree(lemon, out)
    before = content(out)
    assert json.loads(before["report.json"])["trials"]["lemon_right"]["held"]
    code, said = interrupted(["run", "lemon", "--out", str(out)], out, how)
    assert code == (-signal.SIGKILL if how is signal.SIGKILL else 128 + how)
    after = content(out)
    left = {name: after.pop(name) for name in list(after) if name.startswith(f"{UNFINISHED}/")}
    assert after == before
    assert f"{UNFINISHED}/lemon_right.arrow" in left
    assert len(load(out / UNFINISHED / "lemon_right.arrow", partial=True)) >= 100
    if how is not signal.SIGKILL:
        assert f"written until then is in {out / UNFINISHED}" in said
    with lock_folder(out), write_run(out) as staging:  # The next one.
        (staging / "next").touch()
    assert set(content(out)) == {"next", FILES}


@pytest.mark.slow
def test_a_stopped_first_run_is_no_run(tmp_path: Path) -> None:
    out = tmp_path / "f"
    interrupted(["run", "lemon", "--out", str(out)], out, signal.SIGINT)
    assert [path.name for path in out.iterdir()] == [UNFINISHED]


def test_another_run_takes_the_place_of_the_one_before_and_of_nothing_else(
    command: Run, lemon: Path, tmp_path: Path
) -> None:
    (tmp_path / "p.yaml").write_text(POSE)
    out = tmp_path / "f"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    shutil.copytree(lemon, out, dirs_exist_ok=True)
    assert command("run", tmp_path / "p.yaml", "--out", out)[0] == 0
    assert {path.name for path in out.iterdir()} == {"notes.txt", "p.arrow", "p.png", FILES}


@pytest.mark.slow
def test_a_disk_that_is_full_leaves_the_run_before_it_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text(POSE)
    out, run = tmp_path / "f", [sys.executable, "-m", "allegro_twin", "run", str(tmp_path / "p.yaml"), "--out"]
    assert subprocess.run([*run, out], capture_output=True).returncode == 0
    before = content(out)
    size = len(before["p.arrow"]) // 2
    full = subprocess.run(
        [*run, out],
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)),
    )
    assert full.returncode == 2
    assert "cannot go on recording" in full.stderr
    after = content(out)
    assert {name: data for name, data in after.items() if not name.startswith(UNFINISHED)} == before


WRITERS = {
    "run": ["run", "lemon"],
    "evaluate": ["evaluate", "lemon"],
    "plan": ["plan", "lemon"],
    "new": ["new", "lemon"],
    "improve": ["improve", "lemon"],
    "lab": ["lab", "conf/lab_allegro.yaml"],
    "lab-calibrate": ["lab-calibrate", "conf/lab_allegro.yaml"],
    "train": ["train", "Reach"],
    "collect": ["collect", "Reach"],
    "excite": ["excite", "can_virtual", "--pose", "up"],
    "rehearse": ["rehearse", "can_virtual"],
    "schemas": ["schemas"],
    "gallery": ["gallery"],
    "examples": ["examples"],
}


def test_every_command_that_writes_a_folder_is_tried_here() -> None:
    def below(group: Any, name: str) -> Iterator[str]:
        for key, each in getattr(group, "commands", {}).items():
            yield from below(each, f"{name} {key}".strip())
            if any(getattr(param.callback, "__wrapped__", None) is options.folder for param in each.params):
                yield f"{name} {key}".strip()

    assert {*below(built(), "")} == set(WRITERS)


@pytest.mark.parametrize("name", sorted(WRITERS))
def test_the_second_writer_into_a_folder_is_refused_in_one_line(command: Run, tmp_path: Path, name: str) -> None:
    with another_writer(tmp_path / "f"):
        where = [tmp_path / "f"] if name in ("collect", "schemas", "gallery", "examples") else ["--out", tmp_path / "f"]
        code, _, said = command(*WRITERS[name], *where)
    assert code == 2
    assert "another program writes into this folder; wait for it to end" in said
    assert said.count("\n") == 1


def test_a_default_folder_has_one_writer_too(command: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with another_writer(tmp_path / "runs" / "reach"):
        code, _, said = command("train", "Reach")
    assert (code, said.count("\n")) == (2, 1)
    assert "runs/reach: another program writes into this folder" in said


@pytest.mark.slow
def test_two_programs_at_once_are_one_run_and_one_refusal(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text(POSE)
    run = [sys.executable, "-m", "allegro_twin", "run", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "f")]
    both = [subprocess.Popen(run, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) for _ in range(2)]
    said = [program.communicate()[1] for program in both]
    codes = sorted(program.returncode for program in both)
    assert codes in ([0, 2], [0, 0])  # The first may have ended before the second began.
    if codes == [0, 2]:
        assert b"another program writes into this folder" in b"".join(said)
    assert set(content(tmp_path / "f")) == {"p.arrow", "p.png", FILES}


def test_a_folder_that_stayed_empty_is_gone_and_one_that_was_there_is_not(tmp_path: Path) -> None:
    with lock_folder(tmp_path / "new"):
        assert (tmp_path / "new").is_dir()
    assert not (tmp_path / "new").exists()
    with lock_folder(tmp_path):
        pass
    assert tmp_path.is_dir()


def test_a_folder_of_the_user_named_unfinished_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / UNFINISHED).mkdir()
    (tmp_path / UNFINISHED / "thesis.txt").write_text("mine")
    with pytest.raises(RecordingError, match="stands where a run is written"), write_run(tmp_path):
        pass
    assert (tmp_path / UNFINISHED / "thesis.txt").read_text() == "mine"


def test_a_file_of_the_user_that_is_called_as_one_of_a_run_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text("mine")
    with (
        pytest.raises(RecordingError, match=r"report.json: is of no run, and is not replaced by one"),
        write_run(tmp_path, "report.json", keep=True) as staging,
    ):
        (staging / "a").write_text("a")
        (staging / "report.json").write_text("1")
    assert (tmp_path / "report.json").read_text() == "mine"
    assert (tmp_path / UNFINISHED / "a").read_text() == "a"
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("text", ["", "[]", '{"files": ["../../else"]}', '{"files": ["/etc/hosts"]}', '{"files": 3}'])
def test_a_list_that_is_not_of_this_folder_is_refused_before_the_work(tmp_path: Path, text: str) -> None:
    (tmp_path / FILES).write_text(text)
    with pytest.raises(RecordingError, match=rf"{FILES}: .*delete"), write_run(tmp_path):
        pytest.fail("begun")
    assert [path.name for path in tmp_path.iterdir()] == [FILES]


def test_the_files_of_a_run_change_together_and_what_was_added_goes_with_them(tmp_path: Path) -> None:
    with write_run(tmp_path, "report.json") as staging:
        (staging / "grasps").mkdir()
        (staging / "grasps" / "a.yaml").write_text("a")
        (staging / "report.json").write_text("1")
    (tmp_path / "a.png").write_text("picture")
    add_to_run(tmp_path, [tmp_path / "a.png"])
    with pytest.raises(RuntimeError), write_run(tmp_path, "report.json", keep=True) as staging:
        (staging / "b").write_text("b")
        raise RuntimeError
    assert set(content(tmp_path)) == {
        "grasps/a.yaml",
        "report.json",
        "a.png",
        FILES,
        "unfinished/b",
        "unfinished/run.json",
    }
    with write_run(tmp_path, "report.json") as staging:
        (staging / "b").write_text("b")
    assert set(content(tmp_path)) == {"b", FILES}
    assert not (tmp_path / "grasps").exists()


def test_a_program_killed_between_two_files_leaves_no_verdict_and_the_next_run_clears_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("report.json", "old.arrow"):
        with write_run(tmp_path, "report.json") as staging:
            (staging / name).write_text(name)
            (staging / "report.json").write_text("held")
    moves = iter([None, None, OSError(5, "power lost")])  # Two lists and a recording.
    replace = Path.replace

    def stopping(self: Path, target: Path) -> Path:
        if UNFINISHED in self.parts and isinstance(error := next(moves, None), OSError):
            raise error
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", stopping)
    with pytest.raises(RecordingError, match="power lost"), write_run(tmp_path, "report.json") as staging:
        for name in ("1.arrow", "2.arrow", "3.arrow", "report.json"):
            (staging / name).write_text(name)
    assert not (tmp_path / "report.json").exists()
    with write_run(tmp_path, "report.json") as staging:
        (staging / "9.arrow").write_text("")
    assert set(content(tmp_path)) == {"9.arrow", FILES}


def test_a_signal_waits_for_files_that_belong_together() -> None:
    done = False
    with pytest.raises(KeyboardInterrupt), defer_signals():
        os.kill(os.getpid(), signal.SIGINT)
        done = True
    assert done
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_two_programs_do_not_record_into_one_file(command: Run, tmp_path: Path) -> None:
    path = tmp_path / "r.arrow"
    path.write_bytes(b"theirs")
    with another_writer(path, RECORDER):
        status, _, said = command("run", "lemon", "--record", path)
    assert (status, said.count("\n")) == (2, 1)
    assert "another program records to it" in said
    assert path.read_bytes() == b"theirs"


def test_a_place_where_no_folder_can_be_is_refused_and_not_tried_for_ever(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere" / "else")
    broken = "dangling is a link to .*else, which is not there"
    places = {"/proc/nowhere": "", "file": "File exists", "file/below": "", "dangling": broken, "dangling/x": broken}
    for place, why in places.items():
        refused = f"cannot be a folder to write into: .*{why}"
        with pytest.raises(RecordingError, match=refused), lock_folder(tmp_path / place):
            pass


def test_a_folder_that_takes_no_file_is_refused_before_anything_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Run
) -> None:
    def refuse(**_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    for words in (("rehearse", "can_virtual", "--yes", "--out"), ("run", "lemon", "--out"), ("plan", "lemon", "--out")):
        code, shown, said = command(*words, tmp_path / "out")
        assert (code, shown) == (2, "")
        assert said == f"allegro-twin: --out cannot write {tmp_path / 'out'}: Operation not permitted\n"


def test_a_run_that_could_not_begin_leaves_nothing_that_stands_in_the_way_of_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise RecordingError("cannot write run.json: No space left on device")

    with monkeypatch.context() as patch, pytest.raises(RecordingError, match="No space left"):
        patch.setattr(output_folder, "_list", full)
        with write_run(tmp_path):
            pass
    assert list(tmp_path.iterdir()) == []
    (tmp_path / UNFINISHED).mkdir()
    with write_run(tmp_path) as staging:
        (staging / "one").touch()
    assert (tmp_path / "one").is_file()


def test_files_that_were_edited_after_a_run_are_known_also_after_pictures_were_added(tmp_path: Path) -> None:
    with write_run(tmp_path) as staging:
        for name in ("mine.yaml", "same.yaml"):
            (staging / name).write_text("a: 1\n")
    (tmp_path / "mine.yaml").write_text("a: 2\n")
    (tmp_path / "picture.png").touch()
    add_to_run(tmp_path, [tmp_path / "picture.png"])
    assert files_changed_by_hand(tmp_path) == [tmp_path / "mine.yaml"]


def test_an_interruption_says_which_files_have_what_came_until_then_and_which_are_not_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old, new, missing = (tmp_path / name for name in ("old.png", "new.arrow", "missing.rrd"))
    old.write_text("of another run")
    with pytest.raises(KeyboardInterrupt), options.interruptible(old, new, None, missing, then="; go on"):
        new.write_text("rows")
        raise KeyboardInterrupt
    said = " ".join(capsys.readouterr().err.split())
    assert said == f"interrupted: what came until then is in {new}; go on; {old}, {missing} not written"
    with pytest.raises(KeyboardInterrupt), options.interruptible(None):
        raise KeyboardInterrupt
    assert not capsys.readouterr().err
