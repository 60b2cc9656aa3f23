"""A folder with a sweep's rows: a manifest of the question, and Parquet parts that are complete or absent."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from hashlib import sha256
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.sweep.jobs import Sweep
from allegro_twin.sweep.table import KEY

_MANIFEST = "manifest.json"
_FORMAT = "2"
_MADE_OF, _DATA = "made_of", "data"
_ASIDE = "replaced"
"""Folder for rows whose inputs have changed since."""
_NAMES = 5
"""Inputs that are named; more are counted."""


class StoreContent(NamedTuple):
    """Content of a folder."""

    shared: dict[str, Any]
    stamps: dict[str, str]
    table: Any
    """A pyarrow.Table, in no order."""


class RowStore(Protocol):
    """Store of a sweep's rows, a unit at a time."""

    def keys(self) -> set[str]: ...
    def add(self, table: Any) -> None: ...
    def tables(self) -> list[Any]: ...


class MemoryStore:
    """Rows that are gone with the program."""

    def __init__(self) -> None:
        self._tables: list[Any] = []

    def keys(self) -> set[str]:
        return set()

    def add(self, table: Any) -> None:
        self._tables.append(table)

    def tables(self) -> list[Any]:
        return self._tables


class Store:
    """A folder for the rows of a sweep, one part a unit. What is there already is not computed again."""

    def __init__(self, folder: Path | str, tell: Callable[[str], None] = lambda line: None) -> None:
        """`tell`: hears in a line when rows that are there are made of something else than those to come."""
        self.folder, self._tell = Path(folder), tell

    @contextmanager
    def open_for(self, sweep: Sweep) -> Iterator[RowStore]:
        """The folder for that sweep, and for this program alone. Rows that are made of other inputs are put aside, into
        a folder of their own below this one. Raises ConfigError when it is of another sweep, or another program is at
        it, and RecordingError when the disk does not let it."""
        question, made_of = {"format": _FORMAT, **sweep.question()}, sweep.fingerprints()
        content = question | {_MADE_OF: made_of, _DATA: dict(sweep.shared)}
        path = self.folder / _MANIFEST
        if not path.exists():
            self._begin(path, content)
        with ExitStack() as held:
            self._hold(path, held)
            found = _read(path)
            _same(self.folder, found.question, question)
            if differing := _differing(found.made_of, made_of):
                self._renew(path, content, set(sweep.keys()), differing, held)
            for stale in self.folder.glob(".part-*"):  # Of a program that was killed.
                with suppress(OSError):  # Nothing reads it.
                    stale.unlink()
            yield self

    def _hold(self, path: Path, held: ExitStack) -> None:
        manifest = held.enter_context(path.open("rb"))
        try:
            fcntl.flock(manifest, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ConfigError(f"{self.folder}: another program sweeps into it; wait for it to end") from error

    def _renew(
        self, path: Path, content: Mapping[str, Any], keys: set[str], differing: Sequence[str], held: ExitStack
    ) -> None:
        """Put every part with a row that is not of these keys aside, and keep its other rows. The manifest comes last:
        where this is cut off, it is done again."""
        moved, aside = 0, self.folder / _ASIDE
        aside = next(aside / str(n) for n in count(1) if not (aside / str(n)).exists())
        for part in self._parts():
            table = _part(part)
            stays = pc.is_in(table[KEY], pa.array(sorted(keys), pa.string()))
            left = table.num_rows - (pc.sum(stays).as_py() or 0)
            if not left:
                continue
            if left < table.num_rows:
                self.add(table.filter(stays))
            with atomic_file(aside / part.name) as temporary, temporary.open("wb") as file:
                pq.write_table(table, file)
            part.unlink()
            moved += left
        if moved:
            with atomic_file(aside / _MANIFEST) as temporary:
                temporary.write_bytes(path.read_bytes())
            self._tell(
                f"{self.folder}: {moved} rows were made with another {_listed(differing)}: they are made again; "
                f"the old ones are in {aside}"
            )
        with atomic_file(path) as temporary:
            temporary.write_text(json.dumps(content, indent=1))
            self._hold(temporary, held)  # A lock is on the file, whatever it is called.

    def keys(self) -> set[str]:
        """Keys of all rows in the folder. Raises RecordingError."""
        return {key for path in self._parts() for key in _part(path, [KEY])[KEY].to_pylist()}

    def add(self, table: Any) -> None:
        """A part, which is there as a whole or not at all. Raises RecordingError."""
        name = sha256("".join(table[KEY].to_pylist()).encode()).hexdigest()[:24]
        with atomic_file(self.folder / f"part-{name}.parquet") as temporary, temporary.open("wb") as file:
            pq.write_table(table, file)

    def tables(self) -> list[Any]:
        """Tables of all parts. Raises RecordingError."""
        return [_part(path) for path in self._parts()]

    def content(self) -> StoreContent:
        """The content, of any sweep. Raises RecordingError where there is none, or it cannot be read."""
        path = self.folder / _MANIFEST
        if not path.exists():
            raise RecordingError(f"{self.folder}: no {_MANIFEST}: nothing was swept into it")
        found = _read(path)
        tables = self.tables()
        if not tables:
            raise RecordingError(f"{self.folder}: nothing is finished yet; sweep on")
        return StoreContent(
            json.loads(path.read_text()).get(_DATA, {}),
            found.question | found.made_of,
            pa.concat_tables(tables, promote_options="permissive"),
        )

    def _parts(self) -> list[Path]:
        return sorted(self.folder.glob("part-*.parquet"))

    def _begin(self, path: Path, content: Mapping[str, Any]) -> None:
        if self.folder.exists() and any(not each.name.startswith(".") for each in self.folder.iterdir()):
            raise ConfigError(f"{self.folder}: has files but no {_MANIFEST}, so no sweep's; give an empty folder")
        with atomic_file(path) as temporary:
            temporary.write_text(json.dumps(content, indent=1))


class _Manifest(NamedTuple):
    question: dict[str, Any]
    made_of: dict[str, Any]


def _read(path: Path) -> _Manifest:
    try:
        content: dict[str, Any] = dict(json.loads(path.read_text()))
        made_of = dict(content.pop(_MADE_OF, {}))
    except (OSError, ValueError, TypeError) as error:
        raise RecordingError(f"{path}: cannot be read: {error}; sweep into another folder") from error
    content.pop(_DATA, None)  # To be read by people; its hash is what counts.
    return _Manifest(content, made_of)


def _same(folder: Path, found: Mapping[str, Any], mine: Mapping[str, str]) -> None:
    differing = _differing(found, mine)
    if differing:
        told = "; ".join(f"{name} {found.get(name, 'none')} there, {mine.get(name, 'none')} here" for name in differing)
        raise ConfigError(f"{folder} is of another sweep: {told}; give another folder")


def _differing(found: Mapping[str, Any], mine: Mapping[str, str]) -> list[str]:
    return [name for name in {**mine, **found} if found.get(name) != mine.get(name)]


def _listed(names: Sequence[str]) -> str:
    """Some names. A compiled scene is named where nothing else that differs explains it."""
    told = [name for name in names if not name.startswith("scene of ")] or list(names)
    more = len(told) - _NAMES
    return ", ".join(told[:_NAMES]) + (f" and {more} more" if more > 0 else "")


def _part(path: Path, columns: Sequence[str] | None = None) -> Any:
    try:
        with path.open("rb") as file:  # Arrow opens only names that are UTF-8; Python opens every one.
            return pq.read_table(file, columns=columns)
    except (OSError, pa.ArrowInvalid) as error:
        said = " ".join(str(error).split())
        raise RecordingError(f"{path}: cannot be read: {said}; delete it, and its items are computed again") from error
