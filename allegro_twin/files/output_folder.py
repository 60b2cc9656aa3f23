"""Output folders with one writer at a time, whose files are all of one run."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from types import FrameType

from allegro_twin.errors import RecordingError
from allegro_twin.files.atomic_write import atomic_file, write_error

UNFINISHED = "unfinished"
"""The folder in an output folder where a run writes until it ends; what an interrupted run has written stays there."""
FILES = "run.json"
"""List of the files that a run wrote into an output folder: the next run replaces these and no others."""
_WRITTEN = "sha256"
"""In that list: the hash of each file that people edit, as the run wrote it."""
_EDITED = ".yaml"
_TRIES = 100
"""Attempts to lock a folder that its last writer removes, empty, at the same moment."""
_ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)]


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """A folder, which is made, for this program alone. The system frees it when its holder dies; one that was made and
    stayed empty is removed. Raises RecordingError when another program writes into it, or the disk does not let it.

    The lock is an advisory one on the folder itself: flock(2). NFS does not tell other computers of it.
    """
    made = not folder.exists()
    handle = _lock(folder)
    try:
        try:
            tempfile.TemporaryFile(dir=folder).close()
        except OSError as error:
            raise write_error(folder, error) from error
        yield
    finally:
        if made:
            with suppress(OSError):  # It has files, which is what it is for.
                folder.rmdir()
        os.close(handle)


@contextmanager
def write_run(folder: Path, last: str = "", *, keep: bool = False) -> Iterator[Path]:
    """A folder in `folder` to write a run into. When the block ends well, its files take the place of those of the run
    before; the file named `last`, which says what the others are worth, is the first to go and the last to come. When
    it does not end well, `folder` is as it was; `keep`: what was written stays in `folder`/unfinished.

    Files that no run has written stay; where one has a name that this run writes, the run does not end well. `folder`
    is one that this program has `lock_folder`. Raises RecordingError.
    """
    staging = folder / UNFINISHED
    before = _written(folder)
    try:
        if staging.exists() and not (staging / FILES).is_file() and not _is_empty(staging):
            raise RecordingError(f"{staging}: stands where a run is written; move it away, or give another folder")
        shutil.rmtree(staging, ignore_errors=True)
        staging.mkdir(parents=True)
        try:
            _list(staging, [])  # Says whose it is.
        except OSError:
            shutil.rmtree(staging, ignore_errors=True)
            raise
    except OSError as error:
        if isinstance(error, RecordingError):
            raise
        raise write_error(staging, error) from error
    ended = False
    try:
        yield staging
        _replace(folder, before, staging, last)
        ended = True
    finally:
        if ended or not keep or not _files(staging):
            shutil.rmtree(staging, ignore_errors=True)


@contextmanager
def defer_signals() -> Iterator[None]:
    """Signals that end the program end it after the block, which is short: several files that are only true together
    are all written."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)

    before = {number: signal.signal(number, note) for number in _ENDING if signal.getsignal(number) is not None}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])


def _lock(folder: Path) -> int:
    """An open handle that holds the folder's lock."""
    for _ in range(_TRIES):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            links = [place for place in (folder, *folder.parents) if place.is_symlink() and not place.exists()]
            why = f"{links[0]} is a link to {links[0].readlink()}, which is not there" if links else error.strerror
            raise RecordingError(f"{folder}: cannot be a folder to write into: {why or error}") from error
        try:
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except FileNotFoundError:
            continue  # Its last writer has just removed it, empty.
        except OSError as error:
            raise RecordingError(f"{folder}: cannot be a folder to write into: {error.strerror or error}") from error
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(handle), folder.stat()):
                return handle
        except BlockingIOError as error:
            os.close(handle)
            said = f"{folder}: another program writes into this folder; wait for it to end, or give another folder"
            raise RecordingError(said) from error
        except FileNotFoundError:
            pass  # As above.
        except OSError as error:
            os.close(handle)
            raise write_error(folder, error) from error
        os.close(handle)
    raise RecordingError(f"{folder}: cannot be a folder to write into: it vanishes as soon as it is made")


def files_changed_by_hand(folder: Path) -> list[Path]:
    """The YAML files of the run before that are not as it wrote them. Raises RecordingError as `write_run` does."""
    written = _written(folder)
    hashes = _hashes(folder)
    names = {path: path.relative_to(folder).as_posix() for path in written if path.is_file()}
    return [path for path, name in names.items() if name in hashes and hashes[name] != _hash(path)]


def _is_empty(folder: Path) -> bool:
    return folder.is_dir() and not any(folder.iterdir())


def _written(folder: Path) -> list[Path]:
    """The files of the run before. Raises RecordingError for a list that is none, and for one that leads out of the
    folder."""
    path = folder / FILES
    if not path.exists():
        return []
    try:
        names = [str(name) for name in dict(json.loads(path.read_text(encoding="utf-8")))["files"]]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise RecordingError(
            f"{path}: does not list the files of a run ({error}); delete it, or give another folder"
        ) from error
    for name in names:
        if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
            raise RecordingError(f"{path}: {name} is not in {folder}; delete the list, or give another folder")
    return [folder / name for name in names]


def _replace(folder: Path, before: list[Path], staging: Path, last: str) -> None:
    names = _files(staging)
    names.sort(key=lambda name: name == last)
    foreign = next((name for name in names if (folder / name).exists() and folder / name not in before), None)
    if foreign is not None:
        raise RecordingError(
            f"{folder / foreign}: is of no run, and is not replaced by one: move it away, or give another folder"
        )
    listed = {str(each.relative_to(folder).as_posix()) for each in before} | set(names)
    try:
        with defer_signals():
            if last:
                (folder / last).unlink(missing_ok=True)
            _list(folder, sorted(listed))  # Before anything moves: what a killed program leaves is cleared away.
            for path in before:
                path.unlink(missing_ok=True)
                if path.parent != folder:
                    with suppress(OSError):  # It has other files.
                        path.parent.rmdir()
            for name in names:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (staging / name).replace(folder / name)
            _list(folder, sorted(names))
    except RecordingError:
        raise
    except OSError as error:
        raise write_error(folder, error) from error


def add_to_run(folder: Path, paths: list[Path]) -> None:
    """Count files that were made of a run afterwards, such as pictures, among its files. Raises RecordingError."""
    names = sorted({str(path.relative_to(folder).as_posix()) for path in [*_written(folder), *paths]})
    _list(folder, names, _hashes(folder))


def _list(folder: Path, names: list[str], known: Mapping[str, str] | None = None) -> None:
    """`known`: hashes of files as they were written, which somebody may have edited since."""
    new = {name: _hash(folder / name) for name in names if name.endswith(_EDITED) and (folder / name).is_file()}
    content = {"files": names} | ({_WRITTEN: new | dict(known or {})} if new or known else {})
    with atomic_file(folder / FILES) as temporary:
        temporary.write_text(json.dumps(content, indent=1), encoding="utf-8")


def _hashes(folder: Path) -> dict[str, str]:
    """Hashes of the files that a run has written, as `_list` has noted them; empty where it has not."""
    path = folder / FILES
    if not path.exists():
        return {}
    noted = json.loads(path.read_text(encoding="utf-8")).get(_WRITTEN)
    return {str(name): str(each) for name, each in noted.items()} if isinstance(noted, dict) else {}


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _files(staging: Path) -> list[str]:
    """Paths of the files that a run has written, relative to the folder."""
    found = (each.relative_to(staging).as_posix() for each in staging.rglob("*") if each.is_file())
    return sorted(name for name in found if name != FILES)
