"""Files with library entries: those that ship with the package, and the user's."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import NamedTuple, get_args

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root, parse_yaml, read_yaml
from allegro_twin.files.yaml_edit import ENTRIES, has_content, line_of, read_text
from allegro_twin.hands.library.entries import Entry, EntryKind, parse_entry

_FOLDERS: dict[EntryKind, str] = {kind: f"conf/{kind}s" for kind in ("posture", "grasp")} | {
    "trajectory": "conf/trajectories"
}
_NAME = re.compile(r"[a-z][a-z0-9_]*")


class LibraryEntry(NamedTuple):
    """An entry with its name and where it is."""

    name: str
    entry: Entry
    path: Path | None
    """Its file; None for one that was added for this process only."""
    shipped: bool = False

    @property
    def kind(self) -> EntryKind:
        return self.entry.kind

    @property
    def where(self) -> str:
        """For messages: the file, and the entry in it where there are several."""
        if self.path is None:
            return self.name
        return str(self.path) if self.path.stem == self.name else f"{self.path}: {self.name}"


@cache
def shipped_entries(kind: EntryKind | None = None) -> dict[str, Path]:
    """The file of every entry that ships with the package."""
    if kind is not None and kind not in _FOLDERS:
        raise ConfigError(unknown("kind", kind, _FOLDERS))
    kinds = get_args(EntryKind) if kind is None else (kind,)
    return {path.stem: path for each in kinds for path in _files(data_root() / _FOLDERS[each])}


def read_shipped_entry(name: str) -> LibraryEntry:
    """An entry that ships with the package, by its name."""
    return read_single_entry(shipped_entries()[name])._replace(shipped=True)


def read_single_entry(path: Path) -> LibraryEntry:
    """The only entry of a file, or the one that has the file's name. Raises ConfigError."""
    content = read_yaml(path)
    if ENTRIES in content:
        for listed in read_file(path):
            if listed.name == path.stem:
                return listed
        raise ConfigError(f"{path} holds `{ENTRIES}`: give its path to Library, and ask for an entry by name")
    return LibraryEntry(path.stem, parse_entry(content, str(path)), path)


def read_file(path: Path) -> list[LibraryEntry]:
    """All entries of a file: one named as the file, or those under `entries`. Raises ConfigError with the line."""
    text = read_text(path)
    if not has_content(text):
        return []
    content = parse_yaml(text, str(path))

    def line(*keys: int | str) -> str:
        return f"{path}:{line_of(text, keys)}"

    if ENTRIES not in content:
        check_name(path.stem, str(path))
        return [LibraryEntry(path.stem, parse_entry(content, lambda keys: line(*keys)), path)]
    if extra := [str(key) for key in content if key != ENTRIES]:
        raise ConfigError(f"{line(extra[0])}: {extra[0]}: unknown key; a file with `{ENTRIES}` has nothing else")
    entries = content[ENTRIES] or {}
    if not isinstance(entries, dict):
        raise ConfigError(f"{line(ENTRIES)}: {ENTRIES}: must map names to entries, not be a {type(entries).__name__}")
    for name in entries:
        check_name(name, f"{path}: {ENTRIES}")

    def listed(name: str) -> LibraryEntry:
        row = parse_entry(entries[name], lambda keys: f"{line(ENTRIES, name, *keys)}: {name}")
        return LibraryEntry(name, row, path)

    return [listed(name) for name in entries]


def read_all(paths: Iterable[Path]) -> dict[str, LibraryEntry]:
    """All entries in the user's files and folders. Raises ConfigError for a name that is taken already."""
    found: dict[str, LibraryEntry] = {}
    for file in dict.fromkeys(file.resolve() for path in paths for file in _files(path)):
        for listed in read_file(file):
            if listed.name in shipped_entries():
                raise ConfigError(f"{file}: {listed.name!r} ships with the package; choose another name")
            if listed.name in found:
                raise ConfigError(f"{file}: {listed.name!r} is also in {found[listed.name].path}; keep one of them")
            found[listed.name] = listed
    return found


def check_name(name: object, where: str) -> str:
    """A name that can be a file's and a key's. Raises ConfigError."""
    if isinstance(name, bool):
        raise ConfigError(f'{where}: YAML reads this name as {name}; write it in quotes, such as "off" or "on"')
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ConfigError(f"{where}: a name is small letters, digits and _, and begins with a letter; not {name!r}")
    return name


def check_free(name: str) -> str:
    """A name that no entry has which ships with the package. Raises ConfigError."""
    if name in shipped_entries():
        raise ConfigError(f"{name!r} ships with the package and stays as it is; choose another name")
    return name


def name_from(text: str, where: str) -> str:
    """A name as near to a text as `check_name` allows, `coke_can` of `Coke-Can`. Raises ConfigError for a text in which
    there is none."""
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode().lower()
    name = re.sub(r"[^a-z0-9]+", "_", plain).strip("_")
    if not name:
        raise ConfigError(f"{where}: its name has no letter a to z and no digit to name grasps by; rename the file")
    return name if name[0].isalpha() else f"object_{name}"


def _files(path: Path) -> list[Path]:
    """The YAML files in a folder and below, or the file itself; what begins with a dot is not for reading."""
    if not path.is_dir():
        return [path] if path.exists() else []
    inside = (file.relative_to(path) for file in path.rglob("*.yaml"))
    return sorted(path / file for file in inside if not any(part.startswith(".") for part in file.parts))
