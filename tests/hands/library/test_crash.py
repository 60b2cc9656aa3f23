"""A writer that is killed leaves a whole file, and two that write at once lose nothing."""

from __future__ import annotations

import errno
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.errors import RecordingError
from allegro_twin.files.yaml_edit import write_text
from allegro_twin.hands.library.entries import posture_entry
from allegro_twin.hands.library.library import Library
from allegro_twin.spec import HandSpec

# Stores one entry over and over, every joint's position at k/1000 rad for k = 0, 1, …, and says each that is stored.
WRITER = """
import itertools, sys
import numpy as np
import pytest
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import posture_entry
from allegro_twin.files.yaml_edit import write_text
from allegro_twin.hands.library.library import Library
spec, path, name, count = load_spec(), sys.argv[1], sys.argv[2], int(sys.argv[3])
library = Library(path)
for k in itertools.count():
    if k == count:
        break
    entry = name if count < 0 else f"{name}_{k}"
    values = np.full(16, k % 100 / 1000); values[12] = 0.3
    library.add(entry, posture_entry(values, spec), spec)
    library.store(entry, path)
    print(k, flush=True)
"""
START = """\
# A user's own.
entries:
  still:  # Not touched.
    angles: {index: [0, 0, 0, 0], middle: [0, 0, 0, 0], ring: [0, 0, 0, 0], thumb: [0.5, 0, 0, 0]}
"""


def writer(path: Path, name: str, count: int) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path), name, str(count)], stdout=subprocess.PIPE, text=True
    )


@pytest.mark.slow
def test_a_writer_killed_at_any_moment_leaves_the_old_entry_or_the_new_one(tmp_path: Path, spec: HandSpec) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(START)
    chance = random.Random(3)
    seen = set()
    for _ in range(10):
        with writer(path, "shown", -1) as process:
            assert process.stdout is not None
            stored = chance.randrange(10)
            while int(process.stdout.readline()) < stored:
                pass
            time.sleep(chance.uniform(0.0, 0.01))  # About as long as a store: the kill hits anywhere in one.
            process.send_signal(signal.SIGKILL)
        assert path.read_text().startswith(START)
        library = Library(tmp_path)
        position = library.posture("shown", spec)
        assert len(np.unique(np.delete(position, 12))) == 1  # Of one store, not of two.
        assert {e.name for e in library.list("posture") if not e.shipped} == {"shown", "still"}
        seen.add(float(position[0]))
    assert len(seen) > 1
    library.add("after", next(e.entry for e in library.list() if e.name == "still"), spec)
    library.store("after", path)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["mine.yaml"]


@pytest.mark.parametrize("dies_at", ["fsync", "replace"])
def test_a_first_entry_that_cannot_be_written_leaves_the_comments_of_a_file_that_has_nothing_else(
    dies_at: str, tmp_path: Path, spec: HandSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, comments = tmp_path / "mine.yaml", "# A user's own.\r\n  # Nothing yet.\r\n"
    path.write_bytes(comments.encode())
    library = Library(tmp_path)
    library.add("shown", posture_entry(np.full(16, 0.3), spec), spec)

    def dies(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os if dies_at == "fsync" else Path, dies_at, dies)
        with pytest.raises(RecordingError, match="No space left"):
            library.store("shown", path)
    assert path.read_bytes() == comments.encode()
    library.store("shown", path)
    assert path.read_bytes().startswith(comments.encode() + b"entries:\r\n")
    assert Library(path).posture("shown", spec)[12] == 0.3
    assert sorted(file.name for file in tmp_path.iterdir()) == ["mine.yaml"]


@pytest.mark.slow
def test_two_writers_at_once_lose_no_entry(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(START)
    processes = [writer(path, name, 10) for name in ("a", "b")]
    assert [process.wait(60) for process in processes] == [0, 0]
    for process in processes:
        assert process.stdout is not None
        process.stdout.close()
    names = {listed.name for listed in Library(path).list() if not listed.shipped}
    assert names == {"still"} | {f"{name}_{k}" for name in ("a", "b") for k in range(10)}
    assert path.read_text().startswith(START)


def test_the_text_is_on_the_disk_before_it_takes_the_files_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("old")
    seen = []
    monkeypatch.setattr(os, "fsync", lambda handle: seen.append((os.path.isdir(handle), path.read_text())))
    write_text(path, "new")
    assert seen == [(False, "old"), (True, "new")]  # The file before the move, and the folder after it.
