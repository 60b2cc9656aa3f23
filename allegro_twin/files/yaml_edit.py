"""YAML that people edit by hand, changed by a program: comments and every other entry stay as they are, byte for byte.

A file of many entries has one key, `entries`, with one block an entry. Only the lines of the entry that changes are
written anew; the result is read back and compared before it replaces the file, in one piece, on the disk.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.assets import compose_yaml, parse_yaml
from allegro_twin.files.atomic_write import whole_file
from allegro_twin.files.yaml_block import INDENT, edited

ENTRIES = "entries"


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Nobody else who asks for this file's lock has it during the block. The lock is `.<name>.lock` beside the file,
    and the system frees it when its holder dies. Raises RecordingError when the folder cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = path.with_name(f".{path.name}.lock").open("a")
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror or error}") from error
    with handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def read_text(path: Path) -> str:
    """The file's text with its own line ends; empty where there is no file. Raises ConfigError."""
    try:
        return path.read_bytes().decode("utf-8") if path.exists() else ""
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from error


def write_text(path: Path, text: str) -> None:
    """Replace a file whose lock is held: before a crash the old text is on the disk, after it the new one."""
    for left in path.parent.glob(f".{path.stem}.*{path.suffix}"):
        if re.fullmatch(r"\d+", left.name[len(path.stem) + 2 : -len(path.suffix)]):
            left.unlink(missing_ok=True)  # Of a writer that was killed: whoever lives waits for the lock.
    with whole_file(path) as temporary:
        with temporary.open("wb") as file:
            file.write(text.encode("utf-8"))
            file.flush()
            os.fsync(file.fileno())
        if path.exists():
            shutil.copymode(path, temporary)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def holds_anything(text: str) -> bool:
    """Whether there is more than comments. A text that is no YAML holds something: the error is the reader's."""
    try:
        root = compose_yaml(text)
    except yaml.YAMLError:
        return True
    if isinstance(root, yaml.ScalarNode) and not root.value:
        return "\n..." in text  # Nothing behind a `---`, to which can be added unless it is ended by hand.
    return root is not None


def line_of(text: str, keys: Iterable[int | str]) -> int:
    """The line, counted from 1, of what the keys lead to in a YAML text, or of the last part that is there."""
    node, line = compose_yaml(text), 1
    for key in keys:
        found: yaml.Node | None = None
        if isinstance(node, yaml.MappingNode):
            for name, value in node.value:
                if name.value == key:
                    found, line = value, name.start_mark.line + 1
        elif isinstance(node, yaml.SequenceNode) and isinstance(key, int) and key < len(node.value):
            found = node.value[key]
            line = found.start_mark.line + 1
        if found is None:
            break
        node = found
    return line


def with_document(text: str, content: Mapping[str, Any], where: str) -> str:
    """The text of a file that holds one entry, or nothing yet, with new content. Raises ConfigError when that cannot be
    done."""
    end = "\r\n" if "\r\n" in text else "\n"
    kept = "" if holds_anything(text) or not text.strip() else text.rstrip() + end
    made = edited("" if kept else text, content, where)
    return _checked(kept + made.replace("\r\n", "\n").replace("\n", end), dict(content), where)


def with_note(text: str, keys: Iterable[int | str], begins: str, note: str) -> str:
    """The text with a comment above what the keys lead to, in place of one there that begins alike."""
    lines, at = text.splitlines(keepends=True), line_of(text, keys) - 1
    line = lines[at]
    bare = line.lstrip(" ")
    first = at - 1 if at and lines[at - 1].lstrip(" ").startswith(f"# {begins}") else at
    end = "\r\n" if line.endswith("\r\n") else "\n"
    lines[first:at] = [f"{line[: len(line) - len(bare)]}# {begins}{note}{end}"]
    return "".join(lines)


def with_entry(text: str, name: str, content: Mapping[str, Any] | None, where: str) -> str:
    """The text with one entry replaced or added; None takes it out. Raises ConfigError when that cannot be done."""
    old = parse_yaml(text, where) if holds_anything(text) else {}
    expected = {**old, ENTRIES: dict(old.get(ENTRIES) or {})}
    expected[ENTRIES].pop(name, None)
    if content is not None:
        expected[ENTRIES][name] = dict(content)
    end = "\r\n" if "\r\n" in text else "\n"
    if text and not text.endswith("\n"):
        text += end
    if ENTRIES not in old:
        text += f"{ENTRIES}:{end}"
    text = re.sub(rf"(?m)^{ENTRIES}:[ \t]*\{{[ \t]*\}}", f"{ENTRIES}:", text)
    lines, span = text.splitlines(keepends=True), _span(text, name)
    block = [line.removeprefix(" " * span.indent) for line in lines[span.first : span.last]]
    new = "" if content is None else edited("".join(block), {name: content}, where)
    indented = [(" " * span.indent + line if line.strip() else line) for line in new.splitlines(keepends=True)]
    made = "".join(indented).replace("\r\n", "\n").replace("\n", end)
    return _checked("".join(lines[: span.first]) + made + "".join(lines[span.last :]), expected, where)


class _Span(NamedTuple):
    """The lines of an entry, first to last (exclusive), and how far its key is indented."""

    first: int
    last: int
    indent: int


def _span(text: str, name: str) -> _Span:
    """Where an entry is; the empty span where it would be, when there is none."""
    lines = text.splitlines(keepends=True)
    root = compose_yaml(text)
    assert isinstance(root, yaml.MappingNode)
    top = root.value
    place = next(k for k, (key, _) in enumerate(top) if key.value == ENTRIES)
    after = top[place + 1][0].start_mark.line if place + 1 < len(top) else len(lines)
    held = top[place][1]
    keys = [key for key, _ in held.value] if isinstance(held, yaml.MappingNode) else []
    if not keys:
        line = top[place][0].start_mark.line + 1
        return _Span(line, line, INDENT)
    indent = keys[0].start_mark.column
    starts = [*(key.start_mark.line for key in keys), after]
    index = next((k for k, key in enumerate(keys) if key.value == name), len(keys))
    begin = starts[min(index, len(keys) - 1)]
    last = starts[min(index, len(keys) - 1) + 1]
    while last > begin + 1 and _between(lines[last - 1], indent):
        last -= 1
    return _Span(begin if index < len(keys) else last, last, indent)


def _between(line: str, indent: int) -> bool:
    """Whether a line at an entry's end belongs to what follows: empty, or a comment no deeper than the keys."""
    bare = line.strip()
    return not bare or (bare.startswith("#") and len(line) - len(line.lstrip(" ")) <= indent)


def _checked(text: str, expected: Mapping[str, Any], where: str) -> str:
    """The text, if it reads back as what was meant. Raises ConfigError otherwise."""
    if _canonical(parse_yaml(text, where)) != _canonical(dict(expected)):
        raise ConfigError(f"{where}: cannot be changed by a program: write each entry as a block of its own lines")
    return text


def _canonical(content: Any) -> str:
    """One text for equal content, exact to the bit; an `entries` without any is the same as an empty one."""
    if isinstance(content, dict) and ENTRIES in content:
        content = {**content, ENTRIES: content[ENTRIES] or {}}
    return json.dumps(content, sort_keys=True, default=str)
