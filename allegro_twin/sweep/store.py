"""Results in a folder: a manifest that says of which sweep they are, and Parquet parts that are whole or not there."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import pyarrow as pa
import pyarrow.parquet as pq

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.whole import whole_file
from allegro_twin.sweep.jobs import Sweep
from allegro_twin.sweep.table import KEY

_MANIFEST = "manifest.json"
_FORMAT = "1"


class Content(NamedTuple):
    """What a folder holds."""

    shared: dict[str, Any]
    stamps: dict[str, str]
    table: Any
    """A pyarrow.Table, in no order."""


class Kept(Protocol):
    """Where the rows of a sweep go, a unit at a time."""

    def keys(self) -> set[str]: ...
    def add(self, table: Any) -> None: ...
    def tables(self) -> list[Any]: ...


class Memory:
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

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)

    @contextmanager
    def opened(self, sweep: Sweep) -> Iterator[Kept]:
        """The folder for that sweep, and for this program alone. Raises ConfigError when it is of another sweep, or
        another program is at it, and RecordingError when the disk does not let it."""
        stamps = {"format": _FORMAT, **sweep.stamped()}
        path = self.folder / _MANIFEST
        if not path.exists():
            self._begin(path, stamps | {"data": dict(sweep.shared)})
        with path.open("rb") as manifest:
            try:
                fcntl.flock(manifest, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise ConfigError(f"{self.folder}: another program sweeps into it; wait for it to end") from error
            _same(self.folder, _read(path), stamps)
            for stale in self.folder.glob(".part-*"):  # Of a program that was killed.
                with suppress(OSError):  # Nothing reads it.
                    stale.unlink()
            yield self

    def keys(self) -> set[str]:
        """Of all rows that are there. Raises RecordingError."""
        return {key for path in self._parts() for key in _part(path, [KEY])[KEY].to_pylist()}

    def add(self, table: Any) -> None:
        """A part, which is there as a whole or not at all. Raises RecordingError."""
        name = sha256("".join(table[KEY].to_pylist()).encode()).hexdigest()[:24]
        with whole_file(self.folder / f"part-{name}.parquet") as temporary:
            pq.write_table(table, temporary)

    def tables(self) -> list[Any]:
        """All parts. Raises RecordingError."""
        return [_part(path) for path in self._parts()]

    def content(self) -> Content:
        """What is there, of whichever sweep. Raises RecordingError where there is none, or it cannot be read."""
        path = self.folder / _MANIFEST
        if not path.exists():
            raise RecordingError(f"{self.folder}: no {_MANIFEST}: nothing was swept into it")
        stamps = _read(path)
        tables = self.tables()
        if not tables:
            raise RecordingError(f"{self.folder}: nothing is finished yet; sweep on")
        return Content(
            json.loads(path.read_text()).get("data", {}), stamps, pa.concat_tables(tables, promote_options="permissive")
        )

    def _parts(self) -> list[Path]:
        return sorted(self.folder.glob("part-*.parquet"))

    def _begin(self, path: Path, content: Mapping[str, Any]) -> None:
        if self.folder.exists() and any(not each.name.startswith(".") for each in self.folder.iterdir()):
            raise ConfigError(f"{self.folder}: has files but no {_MANIFEST}, so no sweep's; give an empty folder")
        with whole_file(path) as temporary:
            temporary.write_text(json.dumps(content, indent=1))


def _read(path: Path) -> dict[str, Any]:
    try:
        content: dict[str, Any] = dict(json.loads(path.read_text()))
    except (OSError, ValueError, TypeError) as error:
        raise RecordingError(f"{path}: cannot be read: {error}; sweep into another folder") from error
    content.pop("data", None)  # To be read by people; its hash is what counts.
    return content


def _same(folder: Path, found: Mapping[str, Any], mine: Mapping[str, str]) -> None:
    differing = [name for name in {**mine, **found} if found.get(name) != mine.get(name)]
    if differing:
        told = "; ".join(f"{name} {found.get(name, 'none')} there, {mine.get(name, 'none')} here" for name in differing)
        raise ConfigError(f"{folder} is of another sweep: {told}; give another folder")


def _part(path: Path, columns: Sequence[str] | None = None) -> Any:
    try:
        return pq.read_table(path, columns=columns, partitioning=None)
    except (OSError, pa.ArrowInvalid) as error:
        said = " ".join(str(error).split())
        raise RecordingError(f"{path}: cannot be read: {said}; delete it, and its items are computed again") from error
