"""A program writes into a file that people edit, and everything else in it stays as it is, byte for byte."""

from __future__ import annotations

import os
import re
import threading
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

from allegro_twin.errors import ConfigError
from allegro_twin.files.yaml_edit import (
    edit_mapping,
    has_content,
    line_of,
    lock_file,
    read_text,
    replace_document,
    replace_entry,
    set_note,
    write_text,
)

LIBRARY = """# Mine.
entries:
  # The first.
  home:
    hand: allegro  # ours
    position: [0.10, 0.2]

  # Of a Sunday.
  wave:
    times: [0.0, 1.0]
"""


def test_a_note_stands_above_what_it_is_of_indented_as_that() -> None:
    text = "wire:\n  encoder_offset: [1, 2]\n  other: 3\n"
    once = set_note(text, ("wire", "encoder_offset"), "calibrated", " today")
    assert once == "wire:\n  # calibrated today\n  encoder_offset: [1, 2]\n  other: 3\n"


def test_a_note_takes_the_place_of_one_that_begins_alike_and_of_no_other() -> None:
    text = "# calibrated once\nwire: 1\n# by hand\nlimits: 2\n"
    assert set_note(text, ("wire",), "calibrated", " twice") == "# calibrated twice\nwire: 1\n# by hand\nlimits: 2\n"
    made = set_note(text, ("limits",), "calibrated", "")
    assert made == "# calibrated once\nwire: 1\n# by hand\n# calibrated\nlimits: 2\n"
    assert set_note("wire: 1\n", ("wire",), "calibrated", "") == "# calibrated\nwire: 1\n"
    assert set_note("a: 1\r\nwire: 1\r\n", ("wire",), "new", "") == "a: 1\r\n# new\r\nwire: 1\r\n"


@pytest.mark.parametrize(
    ("keys", "line"),
    [((), 1), (("entries",), 2), (("entries", "home"), 4), (("entries", "home", "position"), 6),
     (("entries", "wave", "times", 1), 10), (("entries", "wave", "times", 7), 10), (("entries", "nothing"), 2)],
)  # fmt: skip
def test_the_line_of_a_key_is_counted_from_one_and_that_of_what_is_not_there_is_of_the_last_part_that_is(
    keys: tuple[Any, ...], line: int
) -> None:
    assert line_of(LIBRARY, keys) == line


def test_the_line_of_a_lists_entry_is_its_own() -> None:
    assert line_of("a:\n  - b: 1\n  - b: 2\n", ("a", 1, "b")) == 3


@pytest.mark.parametrize(
    ("text", "something"),
    [
        ("", False),
        ("# only\n", False),
        ("---\n", False),
        ("---\n...\n", True),
        ("a: 1\n", True),
        ("{", True),
        ("0", True),
    ],
)
def test_comments_alone_are_nothing_and_what_is_no_yaml_is_something(text: str, something: bool) -> None:
    assert has_content(text) is something


def test_an_entry_is_changed_in_its_own_lines_with_its_comments_and_digits() -> None:
    made = replace_entry(LIBRARY, "home", {"hand": "allegro", "position": [0.1, 0.3]}, "mine.yaml")
    assert made == LIBRARY.replace("[0.10, 0.2]", "[0.10, 0.3]")
    assert replace_entry(LIBRARY, "home", {"hand": "allegro", "position": [0.1, 0.2]}, "mine.yaml") == LIBRARY


def test_a_new_entry_stands_behind_the_others_before_what_follows_them() -> None:
    made = replace_entry(LIBRARY + "\n# The end.\nversion: 1\n", "fist", {"hand": "leap"}, "mine.yaml")
    assert made == LIBRARY + "  fist:\n    hand: leap\n\n# The end.\nversion: 1\n"


def test_an_entry_that_is_taken_out_takes_its_lines_and_no_others() -> None:
    made = replace_entry(LIBRARY, "home", None, "mine.yaml")
    assert made == "# Mine.\nentries:\n  # The first.\n\n  # Of a Sunday.\n  wave:\n    times: [0.0, 1.0]\n"
    assert yaml.safe_load(made) == {"entries": {"wave": {"times": [0.0, 1.0]}}}
    assert replace_entry(LIBRARY, "nobody", None, "mine.yaml") == LIBRARY


def test_entries_keep_the_indentation_and_the_line_ends_that_they_have() -> None:
    deep = "entries:\r\n    home:\r\n        hand: allegro\r\n"
    made = replace_entry(deep, "fist", {"hand": "leap"}, "mine.yaml")
    assert made == deep + "    fist:\r\n      hand: leap\r\n"
    assert replace_entry("entries: {}", "fist", {"hand": "leap"}, "m") == "entries:\n  fist:\n    hand: leap\n"
    assert replace_entry("", "fist", {"hand": "leap"}, "m") == "entries:\n  fist:\n    hand: leap\n"
    made = replace_entry("version: 1", "fist", {"hand": "leap"}, "m")
    assert made == "version: 1\nentries:\n  fist:\n    hand: leap\n"


def test_a_file_in_one_line_cannot_be_changed_and_says_how_it_could() -> None:
    with pytest.raises(ConfigError, match=r"^mine.yaml.*: (cannot be changed by a program|not valid YAML)"):
        replace_entry("entries: {home: {hand: allegro}}\n", "fist", {"hand": "leap"}, "mine.yaml")


def test_a_document_keeps_the_comments_of_a_file_that_holds_nothing_else() -> None:
    assert replace_document("# Mine.\n\n\n", {"a": 1}, "m") == "# Mine.\na: 1\n"
    assert replace_document("", {"a": [1.5, 2.0]}, "m") == "a: [1.5, 2.0]\n"
    assert replace_document("a: 1  # one\r\nb: 2\r\n", {"a": 1, "b": 3}, "m") == "a: 1  # one\r\nb: 3\r\n"
    assert replace_document("# Mine.\r\n", {"a": 1}, "m") == "# Mine.\r\na: 1\r\n"


@pytest.mark.parametrize(
    ("before", "content", "after"),
    [
        ("a: 1.50\nb: 2\n", {"a": 1.5, "b": 3}, "a: 1.50\nb: 3\n"),
        ("a: 0.0\n", {"a": -0.0}, "a: -0.0\n"),
        ("a: 1\n", {"a": 1.0}, "a: 1.0\n"),
        ("a: [1, 2, 3]  # three\n", {"a": [1, 4]}, "a: [1, 4] # three\n"),
        ("a: [1, 2]\n", {"a": [1, 2, 3]}, "a: [1, 2, 3]\n"),
        ("a:\n  b: 1 # in\n  c: 2\n", {"a": {"b": 1}, "d": 4}, "a:\n  b: 1 # in\nd: 4\n"),
        ("", {"off": "on", "x": "1.0"}, '"off": "on"\nx: "1.0"\n'),
        ("", {"rows": [{"a": 1}, {"a": 2}]}, "rows:\n  - a: 1\n  - a: 2\n"),
        ("", {"m": {"n": {"o": 1e-07}}}, "m:\n  n:\n    o: 1.0e-07\n"),
        ("", {"long": ["word " * 30]}, f"long: [{'word ' * 29}word ]\n"),
    ],
)
def test_what_stays_keeps_its_look_and_what_is_new_is_as_a_person_would_write_it(
    before: str, content: dict[str, Any], after: str
) -> None:
    made = edit_mapping(before, content, "m")
    assert yaml.safe_load(made) == content
    if "word" not in after:
        assert re.sub(" +#", " #", made) == after  # Comments stay in their column.
    else:
        assert made.count("\n") == 1, "it is one line, however long"


def test_a_file_is_replaced_as_a_whole_with_its_mode_and_what_a_killed_writer_left_is_cleared(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    assert read_text(path) == ""
    write_text(path, "a: 1\r\n")
    assert path.read_bytes() == b"a: 1\r\n"
    path.chmod(0o640)
    left, other, kept = (tmp_path / name for name in (".mine.12345.yaml", ".mine.old.yaml", ".yours.1.yaml"))
    for each in (left, other, kept):
        each.write_text("half")
    with lock_file(path):
        write_text(path, "a: ä\n")
    assert read_text(path) == "a: ä\n"
    assert path.stat().st_mode & 0o777 == 0o640
    assert not left.exists()
    assert other.exists()
    assert kept.exists()
    assert not (tmp_path / ".mine.yaml.lock").exists()
    path.write_bytes(b"\xff")
    with pytest.raises(ConfigError, match="mine.yaml: cannot be read"):
        read_text(path)


def test_nobody_else_has_the_lock_meanwhile(tmp_path: Path) -> None:
    import fcntl

    path = tmp_path / "sub" / "mine.yaml"
    with lock_file(path), (tmp_path / "sub" / ".mine.yaml.lock").open("a") as other, pytest.raises(BlockingIOError):
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    assert os.listdir(path.parent) == []


def test_of_many_that_wait_for_the_lock_one_has_it_at_a_time_although_each_removes_it(tmp_path: Path) -> None:
    path = tmp_path / "count.yaml"
    path.write_text("0")

    def add() -> None:
        for _ in range(40):
            with lock_file(path):
                before = int(path.read_text())
                time.sleep(0.0002)
                path.write_text(str(before + 1))

    threads = [threading.Thread(target=add) for _ in range(6)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert path.read_text() == "240"
    assert os.listdir(tmp_path) == ["count.yaml"]
