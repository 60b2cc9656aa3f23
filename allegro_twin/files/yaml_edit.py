"""YAML that people edit by hand, changed by a program: comments and every other entry stay as they are, byte for byte.

A file of many entries has one key, `entries`, with one block an entry. Only the lines of the entry that changes are
written anew; the result is read back and compared before it replaces the file, in one piece, on the disk.
"""

from __future__ import annotations

import fcntl
import json
import math
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, MutableMapping, MutableSequence
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import IO, Any, NamedTuple

import yaml
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.constructor import RoundTripConstructor
from ruamel.yaml.error import YAMLError
from ruamel.yaml.representer import RoundTripRepresenter
from ruamel.yaml.scalarstring import DoubleQuotedScalarString

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.assets import compose_yaml, parse_yaml, refuse_shipped
from allegro_twin.files.atomic_write import atomic_file

INDENT = 2


def edit_mapping(text: str, content: Mapping[str, Any], where: str) -> str:
    """A mapping's text with new content: comments, order and the look of what stays are kept."""
    ruamel = YAML()
    ruamel.Constructor, ruamel.Representer = _Constructor, _Representer
    ruamel.width = 1 << 20
    ruamel.preserve_quotes = True
    ruamel.indent(mapping=INDENT, sequence=2 * INDENT, offset=INDENT)
    try:
        node = ruamel.load(text) if text.strip() else CommentedMap()
        node = CommentedMap() if node is None else node
        _merge(node, content)
        stream = StringIO()
        ruamel.dump(node, stream)
    except YAMLError as error:
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise ConfigError(f"{where}: cannot be changed by a program: {problem}; edit it by hand") from error
    return stream.getvalue()


def _merge(node: MutableMapping[str, Any], content: Mapping[str, Any]) -> None:
    for key in [key for key in node if key not in content]:
        del node[key]
    for key, value in content.items():
        old = node.get(key)
        if isinstance(old, MutableMapping) and isinstance(value, Mapping):
            _merge(old, value)
        elif isinstance(old, CommentedSeq) and isinstance(value, list | tuple):
            _merge_list(old, value)
        elif key not in node or not _same(old, value):
            node[_key(key) if key not in node else key] = _styled(value)


def _merge_list(node: MutableSequence[Any], values: list[Any] | tuple[Any, ...]) -> None:
    for place, value in enumerate(values[: len(node)]):
        if not _same(node[place], value):
            node[place] = _styled(value)
    del node[len(values) :]
    for value in values[len(node) :]:
        node.append(_styled(value))


def _same(old: Any, new: Any) -> bool:
    """Equal to the last bit: the sign of a zero counts, for the mirror image has it."""
    if isinstance(old, float) and isinstance(new, float):
        return old == new and math.copysign(1.0, old) == math.copysign(1.0, new)
    return type(old) is type(new) and bool(old == new)


def _styled(value: Any) -> Any:
    """Plain data as YAML that a person would write: numbers in a row, the rest in blocks."""
    if isinstance(value, Mapping):
        return CommentedMap({_key(key): _styled(inner) for key, inner in value.items()})
    if isinstance(value, list | tuple):
        sequence = CommentedSeq([_styled(inner) for inner in value])
        if not any(isinstance(inner, Mapping | list | tuple) for inner in value):
            sequence.fa.set_flow_style()
        return sequence
    return _key(value) if isinstance(value, str) else value


def _key(word: str) -> str:
    """A word in quotes where YAML 1.1 would read something else: `off` is a posture, not False."""
    try:
        plain = yaml.safe_load(word) == word
    except yaml.YAMLError:
        plain = False
    return word if plain else DoubleQuotedScalarString(word)


class _Written(float):
    """A number as it stands in the file, digit by digit."""

    text: str


class _Constructor(RoundTripConstructor):
    """Keeps the text of every number that stays."""

    def written(self, node: Any) -> _Written:
        number = _Written(self.construct_yaml_float(node))
        number.text = node.value
        return number


class _Representer(RoundTripRepresenter):
    """Writes numbers so that YAML 1.1 and 1.2 read them back to the last bit."""

    def written(self, number: _Written) -> Any:
        return self.represent_scalar(_FLOAT, number.text)

    def plain(self, number: float) -> Any:
        text = repr(number)
        return self.represent_scalar(_FLOAT, text if "." in text else text.replace("e", ".0e"))


_FLOAT = "tag:yaml.org,2002:float"
_Constructor.add_constructor(_FLOAT, _Constructor.written)
_Representer.add_representer(_Written, _Representer.written)
_Representer.add_representer(float, _Representer.plain)


ENTRIES = "entries"


@contextmanager
def lock_file(path: Path) -> Iterator[None]:
    """Hold a file's lock during the block. The lock is `.<name>.lock` next to the file, which is gone afterwards; the
    system frees it when its holder dies. Raises RecordingError when the folder cannot be written."""
    lock = path.with_name(f".{path.name}.lock")
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = lock.open("a")
        except OSError as error:
            raise RecordingError(f"cannot write {path}: {error.strerror or error}") from error
        with handle:
            fcntl.flock(handle, fcntl.LOCK_EX)
            if not _is_file(lock, handle):
                continue  # Its last holder has removed it: whoever comes now makes another.
            try:
                yield
            finally:
                lock.unlink(missing_ok=True)
            return


def _is_file(path: Path, handle: IO[str]) -> bool:
    """Whether an open file is the one that stands there now."""
    try:
        return os.path.samestat(path.stat(), os.fstat(handle.fileno()))
    except FileNotFoundError:
        return False


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
    with atomic_file(path) as temporary:
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


def has_content(text: str) -> bool:
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


def replace_document(text: str, content: Mapping[str, Any], where: str) -> str:
    """The text of a file that holds one entry, or nothing yet, with new content. Raises ConfigError when that cannot be
    done."""
    end = "\r\n" if "\r\n" in text else "\n"
    kept = "" if has_content(text) or not text.strip() else text.rstrip() + end
    made = edit_mapping("" if kept else text, content, where)
    return _checked(kept + made.replace("\r\n", "\n").replace("\n", end), dict(content), where)


def set_note(text: str, keys: Iterable[int | str], begins: str, note: str) -> str:
    """The text with a comment above what the keys lead to, in place of one there that begins alike."""
    lines, at = text.splitlines(keepends=True), line_of(text, keys) - 1
    line = lines[at]
    bare = line.lstrip(" ")
    first = at - 1 if at and lines[at - 1].lstrip(" ").startswith(f"# {begins}") else at
    end = "\r\n" if line.endswith("\r\n") else "\n"
    lines[first:at] = [f"{line[: len(line) - len(bare)]}# {begins}{note}{end}"]
    return "".join(lines)


def replace_entry(text: str, name: str, content: Mapping[str, Any] | None, where: str) -> str:
    """The text with one entry replaced or added; None takes it out. Raises ConfigError when that cannot be done."""
    old = parse_yaml(text, where) if has_content(text) else {}
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
    new = "" if content is None else edit_mapping("".join(block), {name: content}, where)
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
    """Canonical text of content, equal for equal content, exact to the bit; `entries` without a value counts as
    empty."""
    if isinstance(content, dict) and ENTRIES in content:
        content = {**content, ENTRIES: content[ENTRIES] or {}}
    return json.dumps(content, sort_keys=True, default=str)


def write_settings(path: Path, content: dict[str, Any], headline: str) -> None:
    """A YAML file, whole or not at all. Raises ConfigError where it cannot be, or is a file that ships."""
    refuse_shipped(path)
    lines = [f"# {headline}", *(_block(key, value) for key, value in content.items())]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror or error}") from error


def _block(key: str, value: Any) -> str:
    """A row for each part of what is long."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return f"{key}:\n" + "\n".join(f"  - {_line(row)}" for row in value)
    if isinstance(value, dict) and any(isinstance(row, dict) for row in value.values()):
        return f"{key}:\n" + "\n".join(f"  {_line(name)}: {_line(row)}" for name, row in value.items())
    return f"{key}: {_line(value)}"


def _line(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=10_000, sort_keys=False)
    return text.removesuffix("\n").removesuffix("\n...")
